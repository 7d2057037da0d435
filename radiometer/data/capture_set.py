"""Capture sets: the folder that `radiometer bracket` writes, either finished or recognisably unfinished."""

from __future__ import annotations

import contextlib
import datetime as dt
import hashlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Final, Literal, Protocol, Self

import cv2
import numpy as np
from pydantic import AfterValidator, Field, model_validator

from radiometer.data.capture_header import (
    CameraDescription,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.data.frame import MASKED_PIXELS, Bracket, DigitalNumbers, Frame, FrameSettings
from radiometer.data.guards import refuse_large_picture
from radiometer.data.mosaic import COLOURS, in_planes, of_colour, plane_of
from radiometer.data.pile_up import streamed_with_white_levels
from radiometer.data.raw_files import RAW_SUFFIXES, read_raw_colours
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import check_new_folder, dump_yaml, read_yaml, state_folder, write_bytes_atomic
from radiometer.data.tiff_pixels import TIFF_MAGICS, decoded, read_one_picture
from radiometer.data.validation import FileSection, validate, within
from radiometer.errors import CaptureError, OutputError, OutputRefused, UsageError
from radiometer.moments import UNIX_S, moment_of

FORMAT = "radiometer-capture/1"
HEADER_NAME = "capture.yaml"
_PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")  # of a folder of photographs


# Each setting of a frame, and its key in the file.
_KEY_OF_SETTING: Final = {
    name: {"temperature_c": "temperature_C"}.get(name, name)
    for name in (f.name for f in fields(FrameSettings))
    if name not in ("iso", "white_level")
}


class FrameEntry(FileSection):
    """One frame of a capture set as `capture.yaml` lists it."""

    file: str
    exposure_s: Annotated[float, within("exposure")]  # 0 means a bias frame: shutter closed, read out at once
    gain_db: Annotated[float, within("gain")] = 0.0
    f_number: Annotated[float | None, within("f_number")] = None
    black_level_dn: Annotated[float | None, within("black_level")] = None
    temperature_C: Annotated[float | None, within("temperature")] = None  # noqa: N815 (the file's key)
    timestamp_s: float | None = None
    source_level: float = Field(1.0, ge=0)
    pattern: str = "default"
    shutter: Literal["open", "closed"] = "open"
    photons: float | None = Field(None, ge=0)  # mean per pixel, where a descriptor states them

    @model_validator(mode="after")
    def _refuse_light_without_exposure(self) -> Self:
        if self.exposure_s == 0 and self.shutter == "open":
            raise ValueError("an exposure of 0 s means a dark frame; write shutter: closed, or the real exposure")
        return self

    @property
    def settings(self) -> FrameSettings:
        """Return the settings of the frame."""
        return FrameSettings(**{name: getattr(self, key) for name, key in _KEY_OF_SETTING.items()})

    @classmethod
    def of(cls, file: str, settings: FrameSettings, **further: Any) -> FrameEntry:
        """Return the entry for a frame stored under `file` (relative to the capture set), with further facts.

        Raises:
            CaptureError: If a setting is outside its plausible range.
        """
        facts = {key: getattr(settings, name) for name, key in _KEY_OF_SETTING.items()}
        return validate(cls, {"file": file, **facts, **further}, file, CaptureError)


class SettingStatistics(FileSection):
    """What is known of the frames of one setting where their pictures are not: their statistics.

    `variance_dn2` is the temporal variance of a pixel (half that of the difference of a pair), None where one frame is
    all there is.
    """

    exposure_s: Annotated[float, within("exposure")]
    mean_dn: float
    variance_dn2: float | None = Field(None, ge=0)
    frames: int = Field(2, ge=1)
    pixels: int = Field(ge=1)
    gain_db: Annotated[float, within("gain")] = 0.0
    temperature_C: Annotated[float | None, within("temperature")] = None  # noqa: N815 (the file's key)
    timestamp_s: float | None = None
    source_level: float = Field(1.0, ge=0)
    pattern: str = "default"
    shutter: Literal["open", "closed"] = "open"
    photons: float | None = Field(None, ge=0)
    spatial_variance_dn2: float | None = None
    clipped_share: float = Field(0.0, ge=0, le=1)  # of the pixels at full scale
    floor_share: float = Field(0.0, ge=0, le=1)  # of the pixels at 0

    @property
    def settings(self) -> FrameSettings:
        """Return the setting."""
        known = {name: key for name, key in _KEY_OF_SETTING.items() if key in type(self).model_fields}
        return FrameSettings(**{name: getattr(self, key) for name, key in known.items()})


def _as_moment(text: str | None) -> str | None:
    if text is not None:
        moment_of(text)
    return text


class CaptureHeader(FileSection):
    """The whole of `capture.yaml`."""

    format: str = FORMAT
    created: Annotated[str | None, AfterValidator(_as_moment)] = None  # when it was taken: ISO 8601 time in UTC
    camera: CameraDescription
    lens: LensDescription = LensDescription()
    source: SourceDescription = SourceDescription()
    patterns: tuple[str, ...] = ("default",)
    patches: tuple[PatchDescription, ...] = ()
    frames: tuple[FrameEntry, ...] = ()
    statistics: tuple[SettingStatistics, ...] = ()  # instead of frames, where pictures are not to be had

    @property
    def taken(self) -> dt.datetime | None:
        """Return when it was taken, with time zone: `created`, else a first time stamp that is a date; None if unknown.

        A text without a zone counts as UTC, as the form says.
        """
        if self.created is not None:
            return moment_of(self.created)
        stamp = self.frames[0].timestamp_s if self.frames else None
        return dt.datetime.fromtimestamp(stamp, dt.UTC) if stamp is not None and UNIX_S[0] < stamp < UNIX_S[1] else None

    @model_validator(mode="after")
    def _refuse_nothing(self) -> Self:
        if not self.frames and not self.statistics:
            raise ValueError("frames is missing or empty: a capture set holds at least one frame")
        exposures = dict[str, float]()
        for one in self.frames:
            if exposures.setdefault(one.file, one.exposure_s) != one.exposure_s:
                raise ValueError(f"frames names {one.file} for two exposure times; name the file of each")
        return self

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping that is written to the file; what is unknown is left out."""
        unknown = {name for name in ("lens", "source") if getattr(self, name) == type(getattr(self, name))()}
        unknown |= set() if self.statistics else {"statistics"}
        return self.model_dump(mode="json", exclude_none=True, exclude=unknown)


class FrameStore(Protocol):
    """Where the frames of a capture set are when they are not the files of its folder."""

    def read(self, file: str) -> DigitalNumbers:
        """Return the digital numbers of the frame that the header lists under a name."""
        ...

    def digest(self) -> str:
        """Return the SHA-256 of all that the frames were read from, in hexadecimal."""
        ...


@dataclass(frozen=True, slots=True)
class CaptureSet:
    """A finished capture set on disk; frames are read when asked for."""

    path: Path  # the folder
    header: CaptureHeader  # what `capture.yaml` says
    store: FrameStore | None = None  # where the frames are; None for the files of the folder
    # Of a sensor with a mosaic of colours: the plane that its frames are read in; None for the mosaic itself
    colour: str | None = "green"

    @classmethod
    def read(cls, path: Path) -> CaptureSet:
        """Return the capture set in a folder after checking that it is finished and its files exist.

        Raises:
            CaptureError: If the folder is missing, unfinished, or `capture.yaml` is wrong or names absent files.
        """
        if not path.is_dir():
            what = "is not a folder" if path.exists() else "does not exist"
            raise CaptureError(f"{path} {what}; a capture set is a folder that holds {HEADER_NAME}")
        header_path = path / HEADER_NAME
        if not header_path.exists():
            problem = f"{path} holds no {HEADER_NAME}"
            if (path / "frames").is_dir():
                raise CaptureError(f"{problem}: the capture was not finished (it is written last); capture it again")
            raise CaptureError(f"{problem}, nor other frames that are read here: it is no capture set")
        header = _checked_header(header_path)
        if not header.frames:
            raise CaptureError(
                f"{path} holds statistics of settings and no pictures; radiometer characterise takes it, and what "
                "works on pixels cannot"
            )
        return cls(path, _in_planes(header, path))

    @classmethod
    def of_store(cls, path: Path, header: CaptureHeader, store: FrameStore) -> CaptureSet:
        """Return the frames of a store as they are read: a mosaic of colours by its planes.

        Args:
            path: Where they are.
            header: Their header, in pixels of the sensor.
            store: Where the frames are.

        Raises:
            CaptureError: If a mosaic is read by several amplifiers.
        """
        return cls(path, _in_planes(header, path), store)

    def in_colour(self, channel: str) -> CaptureSet:
        """Return the capture set with its frames read in a colour, green for "luminance"; itself without a mosaic.

        Raises:
            UsageError: If there is no such colour, or "each" is asked for.
        """
        if self.header.camera.mosaic is None:
            return self
        colour = "green" if channel == "luminance" else channel
        if colour not in COLOURS:
            raise UsageError(f"{self.path}: --channel {channel}: of a mosaic of colours choose {', '.join(COLOURS)}")
        header = self.header.model_copy(update={"camera": of_colour(self.header.camera, colour)})
        return replace(self, header=header, colour=colour)

    @property
    def mosaic_notes(self) -> tuple[str, ...]:
        """Return in a line which pixels of a mosaic of colours are read; none without a mosaic."""
        mosaic = self.header.camera.mosaic
        return (f"a mosaic of colours ({mosaic}): its {self.colour} pixels are read",) if mosaic else ()

    def __len__(self) -> int:
        return len(self.header.frames)

    def read_frame(self, index: int) -> Frame:
        """Return the frame at a position of the header's list.

        Raises:
            CaptureError: If its file is unreadable, not single-channel, holds values above full scale, or has fewer
                bits than the camera.
        """
        entry = self.header.frames[index]
        dn = self.read_numbers(entry.file)
        bit_depth = self.header.camera.bit_depth
        if bit_depth > 8 and dn.dtype == np.uint8:
            raise CaptureError(
                f"{self.path / entry.file}: holds numbers of 8 bits, where camera.bit_depth is {bit_depth}; export the "
                "frames with all of their bits, or state camera.bit_depth: 8 in capture.yaml"
            )
        masked = (entry.model_extra or {}).get(MASKED_PIXELS)
        extra = {} if masked is None else {MASKED_PIXELS: masked}
        if self.header.camera.mosaic is not None and self.colour is not None:
            extra["channel"] = self.colour
        settings = replace(entry.settings, white_level=self.header.camera.white_level)
        frame = Frame(dn, bit_depth, settings, frame_id=index, extra=extra)
        highest = int(dn.max(initial=0))
        if highest > self.header.camera.full_scale_dn:
            raise CaptureError(
                f"{self.path / entry.file}: holds the value {highest}, above the full scale "
                f"{self.header.camera.full_scale_dn} of camera.bit_depth {self.header.camera.bit_depth}"
            )
        return frame

    def read_frames(self, indices: Sequence[int]) -> Iterator[Frame]:
        """Yield the frames at positions of the header's list with the white level that they show together.

        Args:
            indices: Positions, in the order in which the frames are yielded; a few are held in memory.

        Raises:
            CaptureError: As `read_frame`.
        """
        settings = [self.header.frames[index].settings for index in indices]
        parts = self.header.camera.tap_parts
        return streamed_with_white_levels(settings, lambda place: self.read_frame(indices[place]), parts)

    def read_numbers(self, file: str) -> DigitalNumbers:
        """Return the digital numbers of the frame that the header lists under a name; of a mosaic those of `colour`.

        Raises:
            CaptureError: If it is unreadable or not single-channel.
        """
        numbers = self.store.read(file) if self.store else read_digital_numbers(self.path / file)
        mosaic = self.header.camera.mosaic
        return numbers if mosaic is None or self.colour is None else plane_of(numbers, mosaic, self.colour)

    def frames(self) -> Iterator[Frame]:
        """Yield all frames in the header's order with the white level that they show together, few in memory at a time.

        Raises:
            CaptureError: If a file is unreadable or sizes differ.
        """
        shape: tuple[int, int] | None = None
        for entry, frame in zip(self.header.frames, self.read_frames(range(len(self))), strict=True):
            if shape is not None and frame.shape != shape:
                raise CaptureError(
                    f"{self.path / entry.file}: is {frame.shape[1]} × {frame.shape[0]} pixels, the frames before "
                    f"{shape[1]} × {shape[0]}; all frames of a capture set need one size"
                )
            shape = frame.shape
            yield frame

    def bracket(self, pattern: str | None = None) -> Bracket:
        """Return all frames of one pattern (dark frames always) as a bracket in memory.

        Raises:
            CaptureError: If there is no such frame.
        """
        expected = self.pattern_of(pattern)
        chosen = [f for f in self.frames() if f.settings.is_dark or f.settings.pattern == expected]
        if not any(not f.settings.is_dark for f in chosen):
            raise CaptureError(f"{self.path}: holds no frame of pattern {expected!r} with the shutter open")
        return Bracket.from_frames(chosen, origin=str(self.path))

    def lit_indices(self, pattern: str | None = None) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the indices of the dark frames, and of a pattern's frames at the source's highest level by exposure.

        Args:
            pattern: Name of a displayed pattern; None takes the only one.

        Raises:
            CaptureError: If there is no lit frame of that pattern.
            UsageError: If there are several patterns to choose from.
        """
        entries, chosen = self.header.frames, self.pattern_of(pattern)
        dark = tuple(i for i, entry in enumerate(entries) if entry.shutter == "closed")
        lit = [i for i, e in enumerate(entries) if e.shutter == "open" and e.pattern == chosen and e.source_level > 0]
        if not lit:
            there = ", ".join(sorted({entry.pattern for entry in entries}))
            raise CaptureError(f"{self.path}: holds no lit frame of pattern {chosen!r}; there are: {there}")
        level = max(entries[i].source_level for i in lit)
        lit = [i for i in lit if entries[i].source_level == level]
        return dark, tuple(sorted(lit, key=lambda i: entries[i].settings.effective_exposure_s))

    def lit_bracket(self, pattern: str | None = None) -> Bracket:
        """Return the frames of `lit_indices` in memory: what is known of a patch holds at the source's highest level.

        Raises:
            CaptureError: If there is no lit frame of that pattern, or a frame is unreadable.
            UsageError: If there are several patterns to choose from.
        """
        dark, lit = self.lit_indices(pattern)
        return Bracket.from_frames(self.read_frames((*dark, *lit)), origin=str(self.path))

    def pattern_of(self, pattern: str | None = None) -> str:
        """Return the pattern to read: as chosen, or the only one.

        Args:
            pattern: Name of a displayed pattern; None takes the only one.

        Raises:
            UsageError: If there are several to choose from.
        """
        lit = [one for one in self.header.frames if one.shutter == "open" and one.source_level > 0]
        there = tuple(dict.fromkeys(one.pattern for one in lit))
        if pattern is not None:
            return pattern
        if len(there) > 1:
            raise UsageError(
                f"{self.path}: holds {len(there)} patterns ({', '.join(there)}): choose one with --pattern NAME"
            )
        return there[0] if there else self.header.patterns[0] if self.header.patterns else "default"

    def content_hash(self) -> str:
        """Return the SHA-256 of the header and all frame files, in hexadecimal."""
        if self.store is not None:
            return self.store.digest()
        digest = hashlib.sha256((self.path / HEADER_NAME).read_bytes())
        for entry in self.header.frames:
            with (self.path / entry.file).open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()


def read_header(path: Path) -> CaptureHeader:
    """Return what the `capture.yaml` of a folder says, of frames or of statistics alone.

    Raises:
        CaptureError: If it is missing or wrong, or names absent files.
    """
    return _checked_header(path / HEADER_NAME)


@bounded_reader()
def read_digital_numbers(path: Path) -> DigitalNumbers:
    """Return the raw digital numbers of a single-channel 8- or 16-bit PNG or TIFF, or the green ones of a raw file.

    Raises:
        CaptureError: If the file is missing, truncated, or of another form.
        MissingLibrary: If it is a camera raw file and rawpy is not installed.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        return read_raw_colours(path).green
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise CaptureError(f"cannot read frame {path}: {error.strerror or error}") from error
    _refuse_truncated(path, head=content[:8].tobytes(), tail=content[-16:].tobytes())
    refuse_large_picture(path, content.tobytes())
    if content[:4].tobytes() in TIFF_MAGICS:
        image = read_one_picture(path, content.tobytes(), may_be_mosaic=True)
    else:
        image = decoded(content)
    if image is None:
        raise CaptureError(f"{path}: not a readable PNG or TIFF (damaged or truncated); capture it again")
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise CaptureError(
            f"{path}: expected one channel of 8 or 16 bits, found {image.dtype} with shape {image.shape}"
        )
    numbers: DigitalNumbers = image
    return numbers


def _refuse_truncated(path: Path, *, head: bytes, tail: bytes) -> None:
    """Refuse a PNG without its closing chunk: decoders fill the missing rows with zeros and say nothing."""
    if head.startswith(b"\x89PNG") and b"IEND" not in tail:
        raise CaptureError(f"{path}: the PNG is truncated (no closing chunk); copy or capture it again")


def _checked_header(header_path: Path) -> CaptureHeader:
    mapping: Mapping[str, Any] = read_yaml(header_path)
    found = mapping.get("format", FORMAT)
    if found != FORMAT:
        raise CaptureError(f"{header_path}: format is {found!r}; this version reads {FORMAT!r}")
    header = validate(CaptureHeader, mapping, str(header_path), CaptureError)
    folder = header_path.parent.resolve()
    for entry in header.frames:
        try:
            file = (folder / entry.file).resolve()
            is_there = file.is_file()
        except (OSError, ValueError) as error:  # too long, or with a zero in it
            raise CaptureError(f"{header_path}: frame {entry.file[:80]!r} is not a file name") from error
        if not file.is_relative_to(folder):
            raise CaptureError(f"{header_path}: frame {entry.file!r} is outside the capture set")
        if not is_there:
            raise CaptureError(f"{header_path}: frame {entry.file!r} does not exist; the capture set is incomplete")
        if (entry.black_level_dn or 0.0) >= header.camera.full_scale_dn:
            raise CaptureError(
                f"{header_path}: frame {entry.file!r}: black level {entry.black_level_dn:g} DN is not below full scale,"
                f" {header.camera.full_scale_dn} DN; correct it"
            )
    _refuse_patches_outside(header, header_path)
    return header


def _in_planes(header: CaptureHeader, path: Path) -> CaptureHeader:
    """Return what a header says in pixels of the planes in which frames of a mosaic are read.

    Raises:
        CaptureError: If a mosaic is read by several amplifiers, whose pixels no plane holds as a rectangle.
    """
    if header.camera.mosaic is None:
        return header
    if header.camera.taps:
        raise CaptureError(f"{path}: states camera.mosaic and camera.taps, which are not read together; leave one out")
    camera, lens, patches = in_planes(header.camera, header.lens, header.patches)
    return header.model_copy(update={"camera": camera, "lens": lens, "patches": patches})


def _refuse_patches_outside(header: CaptureHeader, header_path: Path) -> None:
    names = [patch.name for patch in header.patches]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise CaptureError(f"{header_path}: patch name {twice[0]!r} occurs twice; rename one")


class CaptureSetWriter:
    """Writes frames as they arrive and `capture.yaml` last.

    Use as a context manager: leaving it without an error finishes the set; leaving it with one removes
    what was written, so that no half-written capture set stays behind.

    Args:
        path: Folder to create; it must not exist, or be empty.
        camera: The camera as its datasheet believes it to be.
        lens: The lens.
        source: The light source.
        patches: Known regions of the scene.
        patterns: Names of the displayed patterns.
        extra: Further top-level keys of `capture.yaml`.
        rescue: Where the folder takes no more frames, go on in the user's state folder: frames of a camera cannot be
            taken again, those of other files can.
    """

    def __init__(
        self,
        path: Path,
        camera: CameraDescription,
        lens: LensDescription | None = None,
        source: SourceDescription | None = None,
        patches: tuple[PatchDescription, ...] = (),
        patterns: tuple[str, ...] = ("default",),
        extra: dict[str, object] | None = None,
        *,
        rescue: bool = True,
    ) -> None:
        self.path = path
        self._camera, self._lens, self._source = (
            camera,
            lens or LensDescription(),
            source or SourceDescription(),
        )
        self._patches, self._patterns, self._extra = patches, patterns, extra or {}
        self._entries: list[FrameEntry] = []
        self._rescue, self._failure = rescue, ""

    def __enter__(self) -> Self:
        check_new_folder(self.path)
        try:
            (self.path / "frames").mkdir(parents=True)
        except OSError as error:
            raise OutputError(f"cannot create {self.path}: {error.strerror or error}") from error
        return self

    def add(self, frame: Frame, **further: Any) -> None:
        """Write one frame: the camera's own raw file where it has one, its digital numbers as PNG where not.

        Raises:
            OutputError: If the disk refuses it.
        """
        suffix = frame.file.suffix if frame.file else ".png"
        name = f"frames/{len(self._entries):04d}{suffix}"
        self._write(name, frame.file.content if frame.file else self._as_png(frame))
        self._entries.append(FrameEntry.of(name, frame.settings, **further))

    def _as_png(self, frame: Frame) -> bytes:
        done, encoded = cv2.imencode(".png", frame.dn, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not done:
            raise OutputError(f"cannot encode frame {len(self._entries)} as PNG")
        return encoded.tobytes()

    def _write(self, name: str, content: bytes) -> None:
        try:
            write_bytes_atomic(self.path / name, content, rescue=False)
        except OutputError as failure:
            if not self._rescue or self._failure or not self._go_elsewhere(failure):
                raise
            write_bytes_atomic(self.path / name, content, rescue=False)

    def _go_elsewhere(self, failure: OutputError) -> bool:
        """Move what was written to the user's state folder, and return whether that was possible."""
        try:
            state_folder().mkdir(parents=True, exist_ok=True)
            elsewhere = Path(tempfile.mkdtemp(prefix="saved-", dir=state_folder())) / self.path.name[-64:]
            shutil.copytree(self.path, elsewhere)
        except (OSError, shutil.Error):
            return False
        self._remove()
        self.path, self._failure = elsewhere, str(failure)
        return True

    def finish(self) -> CaptureSet:
        """Write `capture.yaml` and return the finished set.

        Raises:
            OutputError: If no frame was added or the disk refuses it. The message names the place of a set that had to
                be finished elsewhere.
        """
        if not self._entries:
            raise OutputError(f"{self.path}: no frame was captured, so there is nothing to finish")
        header = CaptureHeader(
            camera=self._camera,
            lens=self._lens,
            source=self._source,
            patterns=self._patterns,
            patches=self._patches,
            frames=tuple(self._entries),
            **self._extra,
        )
        self._write(HEADER_NAME, dump_yaml(header.to_mapping()).encode())
        if self._failure:
            raise OutputError(
                f"{self._failure}; the finished capture set is saved as {self.path}: move it to where it belongs"
            )
        return CaptureSet(self.path, _in_planes(header, self.path))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            if not (self._failure and (self.path / HEADER_NAME).exists()):  # finished elsewhere: that is the error
                self._remove()
        elif not (self.path / HEADER_NAME).exists():
            try:
                self.finish()
            except BaseException:
                if not (self.path / HEADER_NAME).exists():
                    self._remove()
                raise

    def _remove(self) -> None:
        for file in (self.path / "frames").glob("*"):
            file.unlink(missing_ok=True)
        (self.path / HEADER_NAME).unlink(missing_ok=True)
        for folder in (self.path / "frames", self.path):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()


def refuse_inputs(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Refuse outputs that would replace what a command reads, `--force` or not.

    Args:
        outputs: Files to write.
        inputs: Files and folders to read. Of a folder its `capture.yaml` counts, and the files that this names; without
            one its pictures do.

    Raises:
        OutputRefused: If a file is one of them, under whatever name or link.
    """
    for path in outputs:
        for source in inputs:
            if path.exists() and source.exists() and _is_part(path, source):
                raise OutputRefused(f"{path} belongs to the input {source}; name another file: no input is replaced")


def _is_part(path: Path, source: Path) -> bool:
    if not source.is_dir():
        return path.samefile(source)
    folder, whole = source.resolve(), path.resolve()
    if not whole.is_relative_to(folder):
        return False
    listing = folder / HEADER_NAME
    if not listing.is_file():
        return whole.suffix.lower() in _PICTURES
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return whole == listing or whole.relative_to(folder).as_posix() in listing.read_text(encoding="utf-8")
    return False
