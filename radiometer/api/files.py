"""Frames from files, as one object that the other functions take."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from radiometer.argument_types import with_checked_methods
from radiometer.bench.sources import Source, open_source
from radiometer.data import (
    Bracket,
    CameraDescription,
    FrameSettings,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.data.capture_set import HEADER_NAME
from radiometer.data.capture_set import refuse_inputs as refuse_inputs
from radiometer.data.drawing import new_axes, picture
from radiometer.data.frame import DigitalNumbers
from radiometer.data.storage import check_new_folder as check_new_folder  # the command line asks here
from radiometer.data.storage import check_outputs as check_outputs
from radiometer.data.storage import new_files_stay_new as new_files_stay_new
from radiometer.errors import CaptureError, UsageError
from radiometer.photographs.scene import Photographs
from radiometer.photographs.stated import stated_camera

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PathLike = str | os.PathLike[str]


@with_checked_methods
@dataclass(frozen=True, eq=False, repr=False)
class Stack:
    """Frames of one camera: one bracket per displayed pattern or colour channel.

    Examples:
        >>> import radiometer as rm
        >>> stack = rm.read_photographs("photographs")
        >>> len(stack), list(stack.brackets)
        (3, ['red', 'green', 'blue'])

        >>> stack["green"]
        <Stack photographs: green: 3 frames of 96 × 64 pixels, 8 bits, 0.02 to 0.08 s>
        >>> stack["green"].bracket.light[0].dn.shape
        (64, 96)

    Attributes:
        brackets: The brackets by pattern, or by channel ("red", "luminance", …).
        camera: The camera as it was described.
        lens: The lens as it was described.
        origin: Where the frames came from.
        source: The light as it was described.
        patches: Regions of the scene as they were described.
        photographs: Whether they are photographs: their response and their exposures are not those of a bench camera.
        listed: Name of the list that gives the exposures of photographs; None where EXIF does.
        notes: What is missing and what is doubted of the files.
        taken: When they were taken, with time zone; None where the files do not state it.
    """

    brackets: dict[str, Bracket]
    camera: CameraDescription
    lens: LensDescription
    origin: str
    source: SourceDescription = field(default_factory=SourceDescription)
    patches: tuple[PatchDescription, ...] = ()
    photographs: bool = False
    listed: str | None = None
    notes: tuple[str, ...] = ()
    taken: dt.datetime | None = None

    def __len__(self) -> int:
        """Return the number of brackets."""
        return len(self.brackets)

    def __iter__(self) -> Iterator[Bracket]:
        """Yield the brackets."""
        return iter(self.brackets.values())

    def __getitem__(self, name: str) -> Stack:
        """Return the stack of one pattern or channel alone. Raises KeyError for one that is not there."""
        return replace(self, brackets={name: self.brackets[name]})

    @property
    def bracket(self) -> Bracket:
        """Return the only bracket.

        Raises:
            UsageError: If there are several.
        """
        if len(self.brackets) != 1:
            raise UsageError(
                f"{self.origin} holds {len(self.brackets)} brackets; choose one: stack[{next(iter(self.brackets))!r}]"
            )
        return next(iter(self.brackets.values()))

    def as_photographs(self) -> Photographs:
        """Return what the path of photographs takes."""
        return Photographs(self.brackets, Path(self.origin), self.listed, notes=self.notes)

    def chosen(self, pattern: str | None = None) -> Bracket:
        """Return the bracket of one pattern at the source's highest level.

        Args:
            pattern: Name of a displayed pattern; None takes the only one.

        Raises:
            CaptureError: If there is no such pattern.
            UsageError: If there are several to choose from.
        """
        there = tuple(dict.fromkeys(one.light[0].settings.pattern for one in self.brackets.values()))
        if pattern is None and len(there) > 1:
            raise UsageError(f"{self.origin}: holds {len(there)} patterns ({', '.join(there)}): choose one")
        expected = there[0] if pattern is None else pattern
        lit = [one for one in self.brackets.values() if one.light[0].settings.pattern == expected]
        if not lit:
            raise CaptureError(
                f"{self.origin}: holds no lit frame of pattern {expected!r}; there are: {', '.join(sorted(there))}"
            )
        levels = [one.light[0].settings.source_level for one in lit]
        if levels.count(max(levels)) > 1:
            return self.bracket  # refused: there are several
        return lit[levels.index(max(levels))]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the digital numbers over the effective exposure: median, and the middle 98 % of the pixels.

        Args:
            axes: Where to draw; a new figure by default.
        """
        where = axes if axes is not None else new_axes()
        for name, bracket in self.brackets.items():
            exposures = [frame.settings.effective_exposure_s for frame in bracket.light]
            low, middle, high = np.transpose([np.percentile(_thinned(one.dn), (1, 50, 99)) for one in bracket.light])
            (line,) = where.plot(exposures, middle, "o-", markersize=3, label=name)
            where.fill_between(exposures, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
            where.axhline(bracket.light[0].full_scale_dn, color="black", linewidth=0.8, linestyle=":")
        where.set_xscale("log")
        where.set_xlabel("exposure time × gain in s")
        where.set_ylabel("digital number (DN); dotted: full scale")
        where.legend()
        return where

    def _repr_html_(self) -> str:
        return picture(self.plot, repr(self))

    def __repr__(self) -> str:
        parts = []
        for name, bracket in self.brackets.items():
            times = [frame.settings.exposure_s for frame in bracket.light]
            height, width = bracket.shape
            dark = f" + {len(bracket.dark)} dark" if bracket.dark else ""
            parts.append(
                f"{name}: {len(bracket.light)}{dark} frames of {width} × {height} pixels, {bracket.bit_depth} bits, "
                f"{min(times):.4g} to {max(times):.4g} s"
            )
        return f"<Stack {self.origin}: {'; '.join(parts)}>"


def read(path: PathLike, channel: str = "luminance") -> Stack:
    """Read a capture set or a folder of photographs.

    Examples:
        >>> import radiometer as rm
        >>> stack = rm.read("out/chart")

        >>> stack
        <Stack out/chart: default: 9 + 9 dark frames of 96 × 64 pixels, 12 bits, 0.0002 to 0.0512 s>
        >>> stack.plot().get_xlabel()
        'exposure time × gain in s'

    Args:
        path: Folder with `capture.yaml`, or with photographs and their times.
        channel: Of colour photographs: "luminance", "red", "green", "blue" or "each".

    Raises:
        CaptureError: If the folder is missing, empty, unfinished or inconsistent.
    """
    return stack_of(open_source(Path(path), channel), str(path))


def stack_of(found: Source, origin: str) -> Stack:
    """Return what was read of files as a stack.

    Args:
        found: As read.
        origin: As the user named it.
    """
    header = found.header
    if header is None:
        brackets = {str(one.light[0].extra["channel"]): one for one in found.brackets}
        return Stack(brackets, *stated_camera(found.brackets[0]), origin, photographs=True, listed=found.listed)
    brackets = {_name(one.light[0].settings): one for one in found.brackets}
    return Stack(
        brackets, header.camera, header.lens, origin, header.source, tuple(header.patches), notes=found.doubts,
        taken=header.taken,
    )  # fmt: skip


def read_photographs(path: PathLike, channel: str = "each") -> Stack:
    """Read a folder of photographs whose times are in EXIF or in a list next to them; colours apart by default.

    Examples:
        >>> import radiometer as rm
        >>> list(rm.read_photographs("photographs").brackets)
        ['red', 'green', 'blue']
        >>> len(rm.read_photographs("photographs", "luminance"))
        1

    Args:
        path: The folder.
        channel: "luminance", "red", "green", "blue" or "each".

    Raises:
        CaptureError: If it holds no photographs, or their times are not known.
    """
    if (Path(path) / HEADER_NAME).exists():
        raise CaptureError(f"{path} is a capture set, not a folder of photographs; use radiometer.read")
    return read(path, channel)


def _thinned(dn: DigitalNumbers) -> DigitalNumbers:
    """Return at most some hundred thousand pixels, on an even lattice."""
    step = max(1, round((dn.size / 2e5) ** 0.5))
    return dn[::step, ::step]


def _name(settings: FrameSettings) -> str:
    return settings.pattern if settings.source_level == 1.0 else f"{settings.pattern} at {settings.source_level:g}"
