"""Facts that a file states of its frames, before they become a capture set, and the record of an import."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.data import CaptureHeader, CaptureSet
from radiometer.data.frame import DigitalNumbers, FrameSettings
from radiometer.data.reading import Patch
from radiometer.data.statements import StatementMap
from radiometer.errors import CaptureError, UsageError

TOP_DN = 65535  # the highest digital number that a capture set holds


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """How frames are taken."""

    crop: Patch | None = None  # region to keep; None for the whole frame
    sample: int = 1  # keep every n-th row and column of it, from its first on
    # Value of full scale where the files hold 32-bit or floating-point numbers; None refuses them
    full_scale: float | None = None
    pedestal: float = 0.0  # value added before, so that numbers below zero (processed darks) can be held
    mapped: StatementMap = field(default_factory=StatementMap)  # where the user states that facts stand

    def __post_init__(self) -> None:
        if self.sample < 1:
            raise UsageError(f"sampling every {self.sample} pixels is not possible; give 1 or more")
        if self.full_scale is not None and not (np.isfinite(self.full_scale) and self.full_scale > 0):
            raise UsageError(f"a full scale of {self.full_scale:g} is not possible; give a number above 0")

    def cut(self, pixels: NDArray[Any], where: str) -> NDArray[Any]:
        """Return the requested part of a picture. Raises CaptureError if the crop is not inside it."""
        if self.crop is not None:
            height, width = pixels.shape
            if not self.crop.fits((height, width)):
                raise CaptureError(
                    f"{where}: the crop {self.crop.x},{self.crop.y},{self.crop.width},{self.crop.height} is not "
                    f"on the frame of {width} × {height} pixels"
                )
            pixels = pixels[self.crop.slices]
        return np.ascontiguousarray(pixels[:: self.sample, :: self.sample])

    def place_of_middle(self, shape: tuple[int, int]) -> tuple[float, float]:
        """Return where the middle of a whole picture is in the requested part: x and y in pixels of that.

        Args:
            shape: (height, width) of the whole picture.
        """
        corner = (self.crop.x, self.crop.y) if self.crop is not None else (0, 0)
        x, y = (((side - 1) / 2.0 - begin) / self.sample for side, begin in zip(shape[::-1], corner, strict=True))
        return x, y

    def digital_numbers(self, pixels: NDArray[Any], where: str) -> DigitalNumbers:
        """Return stored values as the digital numbers of a frame, cut to the requested part.

        Integers of up to 16 bits without a sign are kept as they are. With a stated full scale above 65535, or one of
        floating-point numbers, values are scaled so that full scale becomes 65535.

        Raises:
            CaptureError: If values are negative, above what is stated, not finite, or of a kind that needs a full
                scale; the message says which option takes them.
        """
        part = self.cut(pixels, where)
        if part.dtype in (np.uint8, np.uint16) and not self.pedestal:
            kept: DigitalNumbers = part
            return kept
        return _converted(part, self, where)


def _converted(part: NDArray[Any], options: ImportOptions, where: str) -> DigitalNumbers:
    wide = part.dtype.kind == "f" or part.dtype.itemsize > 2
    if wide and options.full_scale is None:
        raise CaptureError(
            f"{where}: holds {part.dtype.name} values, whose full scale no header states; "
            "take them by `radiometer import --full-scale VALUE`"
        )
    values = part.astype(np.float64) + options.pedestal
    if not np.isfinite(values).all():
        raise CaptureError(f"{where}: holds values that are no numbers (NaN or infinite); they cannot be taken")
    lowest, highest = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    if lowest < 0:
        raise CaptureError(
            f"{where}: holds negative values down to {lowest:g} (a processed frame?); "
            f"take them by `radiometer import --pedestal {np.ceil(-lowest) + options.pedestal:g}` or more"
        )
    top = options.full_scale + options.pedestal if wide and options.full_scale is not None else float(TOP_DN)
    if highest > top:
        raise CaptureError(f"{where}: holds the value {highest:g}, above the full scale of {top:g}")
    scale = TOP_DN / top if wide and (top > TOP_DN or part.dtype.kind == "f") else 1.0
    return np.rint(values * scale).astype(np.uint16)


@dataclass(frozen=True, slots=True)
class FoundFrame:
    """One frame in a file, not read yet."""

    file: Path  # the file
    shape: tuple[int, int]  # (height, width) as stored
    stored: str  # kind of the stored numbers, as NumPy names it
    settings: FrameSettings  # what it was taken with
    part: int = 0  # number of the plane or page in it
    parts: int = 1  # how many frames the file holds
    exposure_known: bool = True  # False where no source states the exposure
    # What the file says of the camera, by the keys of the capture set's header
    camera: Mapping[str, Any] = field(default_factory=dict)
    lens: Mapping[str, Any] = field(default_factory=dict)  # the same of the lens
    # Where each fact came from, such as {"exposure_s": "EXPTIME"}
    taken: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()  # what contradicts itself
    extra: Mapping[str, Any] = field(default_factory=dict)  # further facts for the frame's entry
    photons: float | None = None  # mean photons per pixel; None where unknown
    not_used: tuple[str, ...] = ()  # units, directories and pages of its file that no frame was made of

    def doubting(self, *lines: str) -> FoundFrame:
        """Return the frame with further doubts."""
        return replace(self, doubts=(*self.doubts, *lines)) if lines else self

    @property
    def label(self) -> str:
        """Return the name of file and part, for messages."""
        return self.file.name if self.parts == 1 else f"{self.file.name}#{self.part}"


_NAMED_FILES = 3  # names that a line shows


@dataclass(frozen=True, slots=True)
class ImportRecord:
    """The record of an import."""

    taken: tuple[str, ...] = ()  # where each fact came from, such as "exposure_s from EXPTIME (32 frames)"
    missing: tuple[str, ...] = ()  # what no file states and analyses would use
    doubts: tuple[str, ...] = ()  # what contradicts itself, with the files
    left_out: tuple[str, ...] = ()  # files that could not be used, each with its reason
    not_used: tuple[str, ...] = ()  # units, directories, pages and columns of the files that nothing was read from
    mapped: tuple[str, ...] = ()  # where the user stated that facts stand, in the words of `--map`

    def to_mapping(self) -> dict[str, list[str]]:
        """Return the mapping that stands under `imported` in the capture set."""
        return {
            "taken": list(self.taken),
            "missing": list(self.missing),
            "doubts": list(self.doubts),
            "left_out": list(self.left_out),
            "not_used": list(self.not_used),
            "mapped": list(self.mapped),
        }

    def lines(self) -> list[str]:
        """Return all but what was taken as lines for a user."""
        return [
            *(f"left out: {line}" for line in self.left_out),
            *(f"doubt: {line}" for line in self.doubts),
            *(f"missing: {line}" for line in self.missing),
            *(f"not used: {line}" for line in self.not_used),
        ]


def imported_of(capture: CaptureSet) -> ImportRecord:
    """Return the record of the import that a capture set comes from; an empty one where it comes from none."""
    return record_in(capture.header)


def record_in(header: CaptureHeader) -> ImportRecord:
    """Return the record of an import that a header holds; an empty one where it holds none."""
    found: Any = (header.model_extra or {}).get("imported")
    if not isinstance(found, Mapping):
        return ImportRecord()
    lists = {key: tuple(str(line) for line in found.get(key, ())) for key in ImportRecord().to_mapping()}
    return ImportRecord(**lists)


def taken_from(frames: Sequence[FoundFrame]) -> tuple[str, ...]:
    """Return where each fact of the frames came from, one line per fact and place."""
    counts: dict[tuple[str, str], int] = {}
    for frame in frames:
        for fact, place in frame.taken.items():
            counts[fact, place] = counts.get((fact, place), 0) + 1
    return tuple(f"{fact} from {place} ({count} frames)" for (fact, place), count in sorted(counts.items()))


def doubts_about(frames: Iterable[FoundFrame]) -> tuple[str, ...]:
    """Return the frames' doubts, those of one wording together, with the files that they are about."""
    return by_wording((frame.label, frame.doubts) for frame in frames)


def not_used_of(frames: Iterable[FoundFrame]) -> tuple[str, ...]:
    """Return what of the frames' files is not used, with the files."""
    return by_wording((frame.file.name, frame.not_used) for frame in frames)


def by_wording(lines: Iterable[tuple[str, Sequence[str]]]) -> tuple[str, ...]:
    """Return lines about files, those of one wording together with the names of all that they are about."""
    files: dict[str, list[str]] = {}
    for label, several in lines:
        for line in several:
            files.setdefault(line, []).append(label)
    return tuple(f"{named(labels)}: {line}" for line, labels in files.items())


def named(labels: Sequence[str]) -> str:
    """Return a list of files in words, the first three by name."""
    unique = list(dict.fromkeys(labels))
    shown = ", ".join(unique[:_NAMED_FILES])
    more = len(unique) - _NAMED_FILES
    return f"{shown} and {more} more" if more > 0 else shown
