"""A folder of photographs as brackets of frames."""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import structlog

from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.data.mosaic import COLOURS, LUMA
from radiometer.data.pile_up import with_white_levels
from radiometer.data.raw_files import RAW_SUFFIXES
from radiometer.data.white_level import WhiteLevel
from radiometer.errors import CaptureError, UsageError
from radiometer.importing.photograph_pixels import (
    IMAGE_SUFFIXES,
    Photograph,
    luma_of,
    read_photograph,
)
from radiometer.importing.photograph_times import (
    LIST_NAMES,
    PhotographSettings,
    find_list,
    name_of_other_case,
    names_in,
    read_exif,
    read_list,
    with_exact_times,
)
from radiometer.photographs.stated import LIST_GAIN, OF_CAMERA, OF_DEVELOPMENT, OF_FOCUS, with_gain

_LOG: Final = structlog.get_logger(__name__)
CHANNEL_CHOICES: Final = (*COLOURS, "luminance", "each")
_BITS_OF_PICTURES: Final = 8  # cameras develop JPEG files of 8 bits up to their full scale
_NAMED: Final = 4  # photographs that a message names
# So many pixels show whether two pictures may be copies; so many different numbers make a picture.
_COMPARED_PIXELS: Final = 60_000
_VALUES_OF_A_PICTURE: Final = 16


@dataclass(frozen=True, slots=True)
class PhotographFolder:
    """Photographs of one scene in a folder, with their settings."""

    path: Path  # the folder
    settings: dict[str, PhotographSettings]  # settings by file name, in the order of the names
    speeds: IsoSpeeds = field(default_factory=IsoSpeeds)  # what is known of the camera's ISO speeds

    @classmethod
    def open(cls, path: Path, speeds: IsoSpeeds | None = None) -> PhotographFolder:
        """Return the folder after checking that it holds photographs and that each has an exposure time.

        Times come from a list (exposures.txt, exposures.csv or image_list.txt) where there is one, else from EXIF.
        Where a list is present only the files that it names are used.

        Args:
            path: The folder.
            speeds: What is known of the camera's ISO speeds beyond what it states.

        Raises:
            CaptureError: If the folder is missing or empty, a time is missing, or the f-number changes.
            UsageError: If a speed was measured that no photograph states.
        """
        if not path.is_dir():
            raise CaptureError(f"{path} is not a folder; give a folder of photographs or a capture set")
        listed = find_list(path)
        settings = _from_list(path, listed) if listed else _from_exif(path)
        _refuse_changes(path, settings)
        _refuse_unknown_speed(path, settings)
        known = speeds or IsoSpeeds()
        known.refuse_unstated(str(path), {one.iso for one in settings.values() if one.iso})
        return cls(path, settings, known)

    def brackets(
        self,
        channel: str = "luminance",
        report: Callable[[int, int], None] | None = None,
        most_pixels: int | None = None,
        *,
        interpolated: bool = False,
    ) -> list[Bracket]:
        """Return one bracket of the requested channel, or three (red, green, blue) for "each".

        Grey photographs give one bracket whatever the channel. A colour photograph's luminance is the luma
        0.299 R + 0.587 G + 0.114 B of its stored values (ITU-R BT.601), clipped where any channel may be.

        Args:
            channel: "luminance", "red", "green", "blue" or "each".
            report: Called with (files read, files in all) as the work goes on.
            most_pixels: Take every n-th pixel where files hold more than this; None for all.
            interpolated: Of camera raw files: fill in the colours that every pixel lacks.

        Raises:
            CaptureError: If a file is unreadable, or sizes, bit depths or colour differ.
            UsageError: If there is no such channel.
        """
        if channel not in CHANNEL_CHOICES:
            raise UsageError(f"there is no channel {channel!r}; choose one of {', '.join(CHANNEL_CHOICES)}")
        frames: dict[str, list[Frame]] = {}
        by_parts = False
        for done, (name, photograph) in enumerate(self._photographs(most_pixels, interpolated), start=1):
            if report is not None:
                report(done, len(self.settings))
            # Each colour has its white level, of which a luma shows little.
            by_parts = channel == "luminance" and not photograph.is_grey and photograph.bit_depth > _BITS_OF_PICTURES
            for channel_name in _channels_of(photograph, "each" if by_parts else channel):
                frames.setdefault(channel_name, []).append(self._frame(name, photograph, channel_name))
        _refuse_copies(self.path, frames)
        found = {name: with_white_levels(several) for name, several in frames.items()}
        if by_parts:
            found = {channel: [_luminance(colours) for colours in zip(*found.values(), strict=True)]}
        return [Bracket.from_frames(several, origin=str(self.path)) for several in found.values()]

    def _photographs(self, most_pixels: int | None, interpolated: bool) -> Iterator[tuple[str, Photograph]]:
        first: tuple[str, Photograph] | None = None
        # Of a lattice little stays: two whole pictures in memory would be most of what a response takes.
        ahead = 2 if most_pixels is None else 1
        for name, photograph in _in_turn(
            lambda name: read_photograph(self.path / name, most_pixels, interpolated=interpolated), self.settings, ahead
        ):
            if first is None:
                first = (name, photograph)
            _refuse_mixture(self.path, first, (name, photograph))
            yield name, photograph

    def _frame(self, name: str, photograph: Photograph, channel: str) -> Frame:
        known = self.settings[name]
        settings = FrameSettings(
            exposure_s=known.exposure_s,
            gain_db=known.gain_db,
            f_number=known.f_number,
            black_level_dn=photograph.black_level_dn(channel),
            iso=known.iso,
            white_level=None if photograph.white_level_dn is None else WhiteLevel.stated(photograph.white_level_dn),
        )
        extra: dict[str, float | int | str] = {
            "file": name,
            "channel": channel,
            "nominal_exposure_s": known.nominal_exposure_s,
        }
        if photograph.is_raw:
            extra["raw"] = 1
        of_camera = known.camera.items()
        extra |= {OF_CAMERA + key: v for key, v in of_camera if not (photograph.is_raw and key in OF_DEVELOPMENT)}
        if known.gain_db:
            extra[LIST_GAIN] = known.gain_db
        frame = Frame(photograph.plane(channel), photograph.bit_depth, settings, extra=extra)
        return with_gain(frame, self.speeds, [one.iso for one in self.settings.values() if one.iso])


def _luminance(colours: Sequence[Frame]) -> Frame:
    """Return the luma of red, green and blue frames of one photograph, with the lowest of their white levels."""
    first = colours[0]
    dn = luma_of([one.dn for one in colours], [one.saturated_dn for one in colours], first.full_scale_dn)
    blacks = [one.settings.black_level_dn for one in colours]
    known = [black for black in blacks if black is not None]
    settings = replace(
        min(colours, key=lambda one: one.saturated_dn).settings,
        black_level_dn=float(np.dot(LUMA, known)) if len(known) == len(LUMA) else None,
    )
    return replace(first, dn=dn, settings=settings, extra={**first.extra, "channel": "luminance"})


def _in_turn(read: Callable[[str], Photograph], names: Iterable[str], ahead: int) -> Iterator[tuple[str, Photograph]]:
    """Yield every photograph in order while the next ones are decoded, so many at a time."""
    waiting: deque[tuple[str, Future[Photograph]]] = deque()
    with ThreadPoolExecutor(max_workers=ahead) as pool:
        try:
            for name in names:
                waiting.append((name, pool.submit(read, name)))
                if len(waiting) == 2:
                    done, future = waiting.popleft()
                    yield done, future.result()
            while waiting:
                done, future = waiting.popleft()
                yield done, future.result()
        finally:
            for _, future in waiting:
                future.cancel()


def read_photographs(
    path: Path,
    channel: str = "luminance",
    *,
    report: Callable[[int, int], None] | None = None,
    speeds: IsoSpeeds | None = None,
    most_pixels: int | None = None,
    interpolated: bool = False,
) -> list[Bracket]:
    """Return the brackets of a folder of photographs.

    Args:
        path: Folder of JPEG, PNG, TIFF or camera raw files.
        channel: "luminance", "red", "green", "blue", or "each" for the three of them.
        report: Called with (files read, files in all) as the work goes on.
        speeds: What is known of the camera's ISO speeds beyond what it states.
        most_pixels: Take every n-th pixel where files hold more than this; None for all.
        interpolated: Of camera raw files: fill in the colours that every pixel lacks.

    Raises:
        CaptureError: If the folder or a file in it cannot be used; the message names it.
        UsageError: If there is no such channel, or a speed was measured that no photograph states.
    """
    return PhotographFolder.open(path, speeds).brackets(channel, report, most_pixels, interpolated=interpolated)


def image_files(path: Path) -> list[str]:
    """Return the names of the photographs in a folder; camera raw files only where there is nothing else."""
    names = sorted(entry.name for entry in path.iterdir() if entry.is_file() and not entry.name.startswith("."))
    developed = [name for name in names if Path(name).suffix.lower() in IMAGE_SUFFIXES]
    return developed or [name for name in names if Path(name).suffix.lower() in RAW_SUFFIXES]


def _from_list(folder: Path, listed: Path) -> dict[str, PhotographSettings]:
    settings = read_list(listed)
    outside = [name for name in settings if Path(name).name != name]
    if outside:
        raise CaptureError(f"{listed}: {outside[0]!r} is outside the folder; name files in the folder of the list")
    here = set(names_in(folder).values())
    absent = [name for name in settings if name not in here]
    if absent:
        raise CaptureError(_absent(listed, absent, here))
    if unnamed := [name for name in image_files(folder) if name not in settings]:
        shown = ", ".join(unnamed[:_NAMED]) + (" …" if len(unnamed) > _NAMED else "")
        _LOG.warning("photographs that the list does not name are left out", list=str(listed), photographs=shown)
    exif = {name: read_exif(folder / name) for name in sorted(settings)}
    _refuse_other_unit(listed, settings, exif)
    return {name: _with_exif_aperture(settings[name], own) for name, own in exif.items()}


# A list may correct EXIF by some stops; by a thousand or a million it is in another unit.
_OTHER_UNITS: Final = (1e-6, 1e-3, 1e3, 1e6)
_SAME_UNIT_STOPS: Final = 0.5


def _refuse_other_unit(
    listed: Path, settings: Mapping[str, PhotographSettings], exif: Mapping[str, PhotographSettings | None]
) -> None:
    """Refuse a list whose times are those of EXIF in another unit, such as ms that are read as s."""
    stops = [
        math.log2(settings[name].exposure_s / own.nominal_exposure_s) for name, own in exif.items() if own is not None
    ]
    for factor in _OTHER_UNITS:
        if stops and max(abs(s - math.log2(factor)) for s in stops) < _SAME_UNIT_STOPS:
            raise CaptureError(
                f"{listed}: its times are {factor:g} × those in EXIF; write their unit behind them (20 ms) or in the "
                "heading (`name time_ms`)"
            )


def _absent(listed: Path, absent: list[str], here: set[str]) -> str:
    """Return what to say of photographs that a list names and that are not there."""
    named = ", ".join(map(repr, absent[:_NAMED])) + (" …" if len(absent) > _NAMED else "")
    which = "which is" if len(absent) == 1 else f"{len(absent)} files that are"
    other = name_of_other_case(absent[0], here)
    way_out = f"the file is called {other!r}" if other else "correct the name, or remove the line"
    return f"{listed}: names {named}, {which} not in the folder; {way_out}"


def _with_exif_aperture(known: PhotographSettings, exif: PhotographSettings | None) -> PhotographSettings:
    if exif is None:
        return known
    return replace(known, f_number=exif.f_number, iso=exif.iso, iso_doubt=exif.iso_doubt, camera=exif.camera)


def _from_exif(folder: Path) -> dict[str, PhotographSettings]:
    names = image_files(folder)
    if not names:
        raise CaptureError(
            f"{folder} holds no photograph (looked for {', '.join(sorted(IMAGE_SUFFIXES))} and raw files)"
        )
    settings = {}
    for name in names:
        known = read_exif(folder / name)
        if known is None:
            read_photograph(folder / name)  # a damaged file has no EXIF either: say that first
            raise CaptureError(
                f"{folder / name}: has no exposure time (no EXIF); write a file {LIST_NAMES[0]} into "
                "this folder with one line per file: `name seconds`"
            )
        settings[name] = known
    return with_exact_times(settings)


def _refuse_unknown_speed(folder: Path, settings: dict[str, PhotographSettings]) -> None:
    """Refuse photographs of several ISO speeds of which some state none: any of them may be theirs."""
    doubted = [name for name, known in settings.items() if known.iso_doubt]
    if doubted and len(settings) > 1:
        raise CaptureError(
            f"{folder}: {doubted[0]}: {settings[doubted[0]].iso_doubt}. Write the speed into its tag ISOSpeed, or take "
            "the whole bracket at one lower speed"
        )
    silent = [name for name, known in settings.items() if not known.iso]
    stated = sorted({known.iso for known in settings.values() if known.iso})
    if silent and len(stated) > 1:
        raise CaptureError(
            f"{folder}: {silent[0]} states no ISO speed, others {stated[0]:g} to {stated[-1]:g}; leave it out, or take "
            "the whole bracket at one speed"
        )


def _refuse_changes(folder: Path, settings: dict[str, PhotographSettings]) -> None:
    """Refuse photographs of several apertures, cameras, lenses or developments.

    Raises:
        CaptureError: If there are.
    """
    apertures = sorted({known.f_number for known in settings.values() if known.f_number})
    if apertures and apertures[-1] > apertures[0] * 1.01:
        raise CaptureError(
            f"{folder}: the f-number changes between photographs (f/{apertures[0]:.3g} to f/{apertures[-1]:.3g}); "
            "a bracket needs one aperture: change the exposure time alone"
        )
    raw = {Path(name).suffix.lower() in RAW_SUFFIXES for name in settings} == {True}
    for key in dict.fromkeys(key for known in settings.values() for key in known.camera):
        stated = {known.camera[key]: name for name, known in settings.items() if key in known.camera}
        if len(stated) > 1 and key != OF_FOCUS and not (raw and key in OF_DEVELOPMENT):
            (one, name), (other, second), *_ = stated.items()
            raise CaptureError(
                f"{folder}: {name} states {key.replace('_', ' ')} {one}, {second} {other}; a bracket needs one camera "
                "and one setting: change the exposure time alone"
            )


def _refuse_mixture(folder: Path, first: tuple[str, Photograph], other: tuple[str, Photograph]) -> None:
    (name, a), (second, b) = first, other
    if a.is_raw != b.is_raw:
        raise CaptureError(
            f"{folder}: {name} and {second} are not both camera raw files or both developed pictures; use one kind"
        )
    if a.shape != b.shape:
        raise CaptureError(
            f"{folder}: {second} is {b.shape[1]} × {b.shape[0]} pixels, {name} {a.shape[1]} × {a.shape[0]}; "
            "all photographs of a bracket need one size"
        )
    if a.bit_depth != b.bit_depth:
        raise CaptureError(
            f"{folder}: {second} has {b.bit_depth} bits per value, {name} {a.bit_depth}; "
            "all photographs of a bracket need one bit depth"
        )
    if a.is_grey != b.is_grey:
        raise CaptureError(f"{folder}: {name} and {second} are not both grey or both in colour; use one kind")


def _refuse_copies(folder: Path, frames: Mapping[str, Sequence[Frame]]) -> None:
    """Refuse photographs that are copies of each other: noise makes every picture another one.

    Pictures of next to nothing but black and white may be alike.
    """
    first: dict[tuple[int, ...], int] = {}
    for index, planes in enumerate(zip(*frames.values(), strict=True)):
        step = max(1, math.isqrt(planes[0].dn.size // _COMPARED_PIXELS))
        mark = tuple(zlib.crc32(frame.dn[::step, ::step].tobytes()) for frame in planes)
        other = [several[first.setdefault(mark, index)] for several in frames.values()]
        if other[0] is planes[0] or not all(np.array_equal(a.dn, b.dn) for a, b in zip(other, planes, strict=True)):
            continue
        if max(np.unique(frame.dn[::step, ::step]).size for frame in planes) >= _VALUES_OF_A_PICTURE:
            raise CaptureError(
                f"{folder}: {planes[0].extra['file']} and {other[0].extra['file']} hold the same picture, number by "
                "number: one is a copy of the other; leave one out"
            )


def _channels_of(photograph: Photograph, channel: str) -> tuple[str, ...]:
    if photograph.is_grey:
        return ("mono",)
    return COLOURS if channel == "each" else (channel,)


__all__ = ["CHANNEL_CHOICES", "PhotographFolder", "image_files", "read_photographs"]
