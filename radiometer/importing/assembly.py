"""Frames that were found in files, put together as the header of one capture set."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, LensDescription, SourceDescription
from radiometer.data.frame import DigitalNumbers
from radiometer.data.guards import safe_file_name
from radiometer.data.mosaic import shifted
from radiometer.data.validation import validate
from radiometer.errors import CaptureError, DamagedFileError
from radiometer.importing.found import (
    FoundFrame,
    ImportOptions,
    ImportRecord,
    by_wording,
    doubts_about,
    not_used_of,
    taken_from,
)

_LOOKED_AT: Final = 4  # frames whose codes are looked at for padding and clipping
_FEWEST_CODES: Final = 10  # different ones: all even by chance once in a thousand
_CODES_FROM: Final = 65_536  # pixels of a frame that show its codes
_FEWEST_CLIPPED: Final = 4  # noise alone puts hardly two pixels on the same highest code
_CAMERA_KEYS: Final = (
    "vendor", "model", "serial", "unit", "mode", "band", "wavelength_nm", "binning", "pixel_pitch_um",
    "conversion_gain_e_per_dn", "read_noise_e", "taps",
    "mosaic",
)  # fmt: skip
# What a set is called by among several.
_OWN_KEYS: Final = ("vendor", "model", "serial", "band", "binning", "mode", "scene")
_UNBINNED: Final = ("binning", "1")  # as frames that state nothing of it
_MASKED_SAME_DN: Final = 1.0  # masked rows are read to a fraction of a DN
_UNEVEN_PERCENT: Final = 0.5  # of light that a calibration moves, above which it is reported


@dataclass(frozen=True, slots=True)
class Assembled:
    """The header of one camera's frames, and the frame behind each name in it."""

    title: str
    header: CaptureHeader
    frames: Mapping[str, FoundFrame]


def by_camera(frames: Iterable[FoundFrame]) -> dict[str, list[FoundFrame]]:
    """Return the frames by camera: maker, model, serial number, band, binning, own settings, scene and frame size.

    Frames that state no gain are a separate set where others state one: their gain is unknown, and not 0 dB.
    """
    keys: dict[tuple[Any, ...], list[FoundFrame]] = {}
    for frame in frames:
        own = [None if (k, frame.camera.get(k)) == _UNBINNED else frame.camera.get(k) for k in _OWN_KEYS]
        key = (*own, *frame.shape, "gain_db" in frame.taken, frame.camera.get("unit"))
        keys.setdefault(key, []).append(frame)
    titles = _titles(list(keys))
    return dict(zip(titles, keys.values(), strict=True))


def _titles(keys: Sequence[tuple[Any, ...]]) -> list[str]:
    """Return a short unique name for each camera: the parts in which they differ."""
    if len(keys) <= 1:
        return ["camera"] * len(keys)
    differing = [i for i in range(len(keys[0]) - 1) if len({key[i] for key in keys}) > 1]
    words = ["-".join(str(key[i]) for i in differing if key[i] is not None) or "camera" for key in keys]
    seen: Counter[str] = Counter()
    unique = []
    for word in (safe_file_name(re.sub(r"[^\w.+-]+", "_", word)) for word in words):  # they become folders
        seen[word] += 1
        unique.append(word if seen[word] == 1 else f"{word}-{seen[word]}")
    return unique


def assemble(
    title: str,
    frames: Sequence[FoundFrame],
    root: Path,
    options: ImportOptions,
    read: Any,
    left_out: Sequence[str] = (),
    bit_depth: int | None = None,
) -> Assembled:
    """Return the header of a capture set for frames of one camera, by the time they were taken.

    Args:
        root: Folder that the names of the frames are relative to.
        read: Returns the digital numbers of a frame, for a look at their codes.
        left_out: Lines about files that could not be used.
        bit_depth: Bits per pixel where a descriptor states them.

    Raises:
        CaptureError: If no frame's exposure is known, or frames of several unknown gains are mixed.
    """
    known = [f for f in frames if f.exposure_known and (f.settings.exposure_s > 0 or f.settings.is_dark)]
    without = by_wording((f.label, _why_no_exposure(f)) for f in frames if f not in known)
    if not known:
        raise CaptureError(
            f"{root}: {'; '.join(without)}. Name it: radiometer import … --map exposure=PLACE:UNIT, "
            "or --map exposure=NUMBER:UNIT where one number is true of all frames, or write a file exposures.txt into "
            "the folder with one line per file: `name seconds`"
        )
    lines = [*left_out, *without]
    ordered = _plain_patterns(_by_time(known))
    codes = _Codes.of(ordered, options, read, bit_depth)
    camera, disagreeing = _camera(ordered, codes, options)
    origin_s = ordered[0].settings.timestamp_s
    entries = {_name(frame, root): (frame, _entry(frame, root, origin_s)) for frame in ordered}
    record = ImportRecord(
        taken_from(ordered),
        tuple(_missing(ordered, camera)),
        (*doubts_about(ordered), *disagreeing, *codes.doubts, *_black_by_gain(ordered), *_uncorrected(ordered)),
        tuple(lines),
        not_used_of(frames),
        options.mapped.words(),
    )
    header = validate(
        CaptureHeader,
        {
            "camera": camera,
            "lens": _lens(ordered, options),
            "source": SourceDescription(kind="sphere" if ordered[0].photons is not None else "scene"),
            "patterns": tuple(dict.fromkeys(f.settings.pattern for f in ordered)),
            "frames": tuple(entry for _, entry in entries.values()),
            "imported": record.to_mapping(),
            **({"created": datetime.fromtimestamp(origin_s, UTC).isoformat()} if origin_s and origin_s > 1e9 else {}),
        },
        str(root),
        CaptureError,
    )
    return Assembled(title, header, {name: frame for name, (frame, _) in entries.items()})


def _why_no_exposure(frame: FoundFrame) -> tuple[str, ...]:
    reported = tuple(doubt for doubt in frame.doubts if "exposure" in doubt)
    return reported or ("no exposure time is known",)


def _by_time(frames: Sequence[FoundFrame]) -> list[FoundFrame]:
    stamps = [f.settings.timestamp_s for f in frames]
    if any(stamp is None for stamp in stamps):
        return sorted(frames, key=lambda f: (str(f.file), f.part))
    return sorted(frames, key=lambda f: (f.settings.timestamp_s or 0.0, str(f.file), f.part))


def _plain_patterns(frames: Sequence[FoundFrame]) -> list[FoundFrame]:
    """Return the frames with one pattern's name where only one occurs in the light; darks have none."""
    lit = {f.settings.pattern for f in frames if not f.settings.is_dark}
    return [
        f if len(lit) > 1 and not f.settings.is_dark else replace(f, settings=replace(f.settings, pattern="default"))
        for f in frames
    ]


def _name(frame: FoundFrame, root: Path) -> str:
    try:
        name = frame.file.relative_to(root).as_posix()
    except ValueError:
        name = frame.file.as_posix()
    return name if frame.parts == 1 else f"{name}#{frame.part}"


def _entry(frame: FoundFrame, root: Path, origin_s: float | None) -> FrameEntry:
    settings = frame.settings
    if origin_s is not None and settings.timestamp_s is not None and origin_s > 1e9:
        settings = replace(settings, timestamp_s=round(settings.timestamp_s - origin_s, 6))
    return FrameEntry.of(_name(frame, root), settings, photons=frame.photons, **frame.extra)


@dataclass(frozen=True, slots=True)
class _Codes:
    """What the codes of some frames say of the converter."""

    bit_depth: int
    step_dn: int
    doubts: tuple[str, ...]

    @classmethod
    def of(cls, frames: Sequence[FoundFrame], options: ImportOptions, read: Any, stated: int | None) -> _Codes:
        looked = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _LOOKED_AT).astype(int))]
        pixels = list[DigitalNumbers]()
        damage: DamagedFileError | None = None
        for frame in looked:
            try:
                pixels.append(read(frame, options))
            except DamagedFileError as error:  # left out and named when the frames are copied
                damage = error
        if damage is not None and not pixels:
            raise damage
        bits = 0
        for dn in pixels:
            bits |= int(np.bitwise_or.reduce(dn, axis=None))
        step = bits & -bits if _determines_step(pixels, bits) else 1
        container = 8 * max(dn.dtype.itemsize for dn in pixels)
        depth, doubts = (stated, []) if stated else _converter_bits(pixels, container, looked)
        if step > 1 and not stated:
            real = container - (step.bit_length() - 1)
            doubts.append(
                f"all values are multiples of {step}: {real} bits written in {container} (padded), so that rounding "
                f"has steps of {step} DN"
            )
        if any(np.dtype(f.stored).kind == "f" or np.dtype(f.stored).itemsize > 2 for f in looked):
            top = options.full_scale or 0.0
            doubts.append(f"{looked[0].stored} values were taken with the stated full scale of {top:g}")
        return cls(depth, step, tuple(doubts))


def _determines_step(pixels: Sequence[DigitalNumbers], bits: int) -> bool:
    """Return whether the codes are many enough to be multiples of more than 1 by no chance."""
    if bits == 0 or bits & 1:
        return False
    codes = set[int]()
    for dn in pixels:
        codes.update(np.unique(dn.ravel()[:: max(dn.size // _CODES_FROM, 1)]).tolist())
    return len(codes) >= _FEWEST_CODES


def _converter_bits(
    pixels: Sequence[DigitalNumbers], container: int, frames: Sequence[FoundFrame]
) -> tuple[int, list[str]]:
    """Return the bits per pixel: fewer than the container's where pixels pile up at the top of fewer."""
    highest = max(int(dn.max(initial=0)) for dn in pixels)
    for bits in (10, 12, 14):
        top = (1 << bits) - 1
        piled = sum(int(np.count_nonzero(dn == top)) for dn in pixels)
        if highest == top and container == 16 and piled >= _FEWEST_CLIPPED:
            return bits, [f"{piled} pixels pile up at {top}, the highest value: {bits} bits are taken"]
    tops = {f.camera["stated_top_dn"] for f in frames if "stated_top_dn" in f.camera}
    top_stated = max(tops, default=0)
    for bits in (10, 12, 14):
        if top_stated == (1 << bits) - 1 and highest <= top_stated:
            return bits, []
    return container, []


def _camera(frames: Sequence[FoundFrame], codes: _Codes, options: ImportOptions) -> tuple[CameraDescription, list[str]]:
    facts: dict[str, Any] = {"bit_depth": codes.bit_depth}
    doubts = []
    for key in _CAMERA_KEYS:
        values = Counter(f.camera[key] for f in frames if key in f.camera)
        if values:
            facts[key] = values.most_common(1)[0][0]
        if len(values) > 1:
            doubts.append(f"headers disagree on {key}: {', '.join(map(str, values))}; the most frequent is taken")
    filters = {f.camera.get("filter") for f in frames if not f.settings.is_dark}
    if len(filters) == 1:  # of several, each is a pattern
        facts["filter"] = filters.pop()
    if "taps" in facts and (options.crop or options.sample > 1):
        del facts["taps"]
        doubts.append("the sections of amplifiers are left out: they hold for whole frames only")
    if "mosaic" in facts:
        doubts += _placed_mosaic(facts, options)
    if codes.step_dn > 1:
        facts["code_step_dn"] = codes.step_dn
    if "pixel_pitch_um" in facts and options.sample > 1:
        facts["pixel_spacing_um"] = facts["pixel_pitch_um"] * options.sample
    blacks = {f.settings.black_level_dn for f in frames if f.settings.black_level_dn is not None}
    if len(blacks) == 1:
        facts["black_level_dn"] = blacks.pop()
    top_dn, doubtful = _white_level(frames, codes, options)
    if top_dn is not None:
        facts["white_level_dn"] = top_dn
    return validate(CameraDescription, facts, frames[0].label, CaptureError), [*doubts, *doubtful]


def _placed_mosaic(facts: dict[str, Any], options: ImportOptions) -> list[str]:
    """Put the mosaic of the requested part in place of that of the whole frame; return what speaks against any."""
    of_cells = "binning" in facts and facts["binning"] != _UNBINNED[1]
    if of_cells or "taps" in facts or options.sample % 2 == 0:
        mosaic = facts.pop("mosaic")
        return [f"{mosaic}: pixels under filters of several colours count as one channel"]
    if options.crop is not None:
        facts["mosaic"] = shifted(facts["mosaic"], options.crop.x, options.crop.y)
    return []


def _white_level(frames: Sequence[FoundFrame], codes: _Codes, options: ImportOptions) -> tuple[float | None, list[str]]:
    """Return the digital number from which the files say that pixels are saturated, and what is doubtful of it."""
    full_scale = (1 << codes.bit_depth) - 1
    stated = sorted({f.camera["stated_white_dn"] + options.pedestal for f in frames if "stated_white_dn" in f.camera})
    if not stated or options.full_scale is not None:  # scaled numbers are none that a header speaks of
        return None, []
    lowest, highest = stated[0], stated[-1]
    if highest > full_scale + options.pedestal:
        return None, [f"headers state saturation at {highest:g}, above the {full_scale} of the files: not used"]
    doubts = (
        [f"headers state saturation from {lowest:g} to {highest:g}: the lowest is taken"] if lowest < highest else []
    )
    return (lowest if lowest < full_scale else None), doubts


def _lens(frames: Sequence[FoundFrame], options: ImportOptions) -> LensDescription:
    facts: dict[str, Any] = {}
    if options.crop is not None or options.sample > 1:  # the optical axis is where it was: at the middle of the file's
        facts["principal_point_px"] = options.place_of_middle(frames[0].shape)
    for frame in frames:
        for key, value in frame.lens.items():
            facts.setdefault(key, value)
    stops = {f.settings.f_number for f in frames if f.settings.f_number}
    if len(stops) == 1:
        facts["f_number"] = stops.pop()
    return validate(LensDescription, facts, frames[0].label, CaptureError)


def _black_by_gain(frames: Sequence[FoundFrame]) -> list[str]:
    """Return a line that reports how far masked rows are above the black level tag at each gain."""
    by_gain: dict[float, list[float]] = {}
    for frame in frames:
        masked, stated = frame.extra.get("masked_rows_dn"), frame.settings.black_level_dn
        if masked is not None and stated is not None:
            by_gain.setdefault(round(frame.settings.gain_db, 2), []).append(masked - stated)
    offsets = {gain: float(np.mean(values)) for gain, values in sorted(by_gain.items())}
    if not offsets or max(map(abs, offsets.values())) < _MASKED_SAME_DN:
        return []
    offsets_text = ", ".join(f"{offset:+.0f} DN at {gain:g} dB" for gain, offset in offsets.items())
    kind = "black_level_offset and black_level_gain_slope" if len(offsets) > 1 else "black_level_offset"
    return [f"masked rows differ from the black level tag by {offsets_text}: {kind}"]


def _uncorrected(frames: Sequence[FoundFrame]) -> list[str]:
    """Return what the maker's calibration says of rows and corners: raw frames hold it, nothing here takes it out."""
    lines = []
    rows = [100.0 * (f.extra["maker_row_gain_last"] - 1.0) for f in frames if "maker_row_gain_last" in f.extra]
    if rows and max(map(abs, rows)) > _UNEVEN_PERCENT:
        lines.append(
            "the maker's calibration states row-dependent exposure: the last row has "
            f"{_span(rows, '+.1f')} % more light than the first. The frames include it: row_dependent_exposure"
        )
    corners = [v for frame in frames for v in frame.lens.get("maker_corner_illumination", ())]
    if corners and 100.0 * (1.0 - min(corners)) > _UNEVEN_PERCENT:
        lines.append(
            f"the maker's calibration states {_span(corners, '.2f')} of the middle's light in the corners. "
            "The frames include it: natural_vignetting or mechanical_vignetting"
        )
    return lines


def _span(values: Sequence[float], how: str) -> str:
    low, high = f"{min(values):{how}}", f"{max(values):{how}}"
    return low if low == high else f"{low} to {high}"


def _missing(frames: Sequence[FoundFrame], camera: CameraDescription) -> list[str]:
    found = []
    if not any(f.settings.is_dark for f in frames):
        found += _without_darks(frames, camera)
    if all(f.settings.is_dark for f in frames):
        found.append("no frames with light: no photon transfer, no linearity, no saturation")
    if all(f.settings.temperature_c is None for f in frames):
        found.append("sensor temperature")
    if all(f.settings.timestamp_s is None for f in frames):
        found.append("time of the frames: their order is that of their names")
    if camera.conversion_gain_e_per_dn is None:
        found.append("conversion gain in e-/DN")
    counts = Counter((f.settings.exposure_s, f.settings.gain_db, f.settings.shutter) for f in frames)
    single = sum(1 for number in counts.values() if number == 1)
    if single:
        found.append(f"{single} of {len(counts)} settings have one frame only: no temporal noise from them")
    return found


def _without_darks(frames: Sequence[FoundFrame], camera: CameraDescription) -> list[str]:
    """Return what is missing without dark frames: less where the sensor reads pixels without light in every frame."""
    if all("masked_rows_dn" in frame.extra for frame in frames):
        return []
    if camera.taps and all(tap.overscan for tap in camera.taps):
        return ["no dark frames: overscan gives the black level, and the dark signal stays in the light"]
    return ["no dark frames: black level and read noise cannot be separated from the light"]
