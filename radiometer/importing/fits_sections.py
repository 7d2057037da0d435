"""Sections of FITS headers: which amplifier reads which pixels, in one picture or in one unit per amplifier.

Sections are `[x1:x2,y1:y2]`, counted from 1, both ends included. A range that falls is read from its higher end.
Keywords are those of NOAO and IRAF (CCDPROC, MSCRED) and their spellings in use: DATASEC or TRIMSEC and BIASSEC, with a
number or letter where one picture holds several amplifiers; DETSEC places a unit's pixels on the detector.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radiometer.data.capture_header import TapDescription
from radiometer.data.statements import Statement
from radiometer.errors import CaptureError

_SECTION: Final = re.compile(r"\[?\s*(\d+)\s*:\s*(\d+)\s*,\s*(\d+)\s*:\s*(\d+)\s*\]?")
# The trimmed section comes first: a data section may hold columns at the edge that are to be cut.
_DATA: Final = ("TRIMSEC", "TSEC", "DATASEC", "DSEC")
_OVERSCAN: Final = ("BIASSEC", "BSEC")
_OF_DETECTOR: Final = ("DETSEC", "CCDSEC")
_SUFFIX: Final = re.compile(r"(?:TRIMSEC|TSEC|DATASEC|DSEC)_?(\d{1,2}|[A-P])")


class Section(NamedTuple):
    """A rectangle of pixels, counted from 0, and whether its ranges fall."""

    x: int
    y: int
    width: int
    height: int
    x_falls: bool
    y_falls: bool

    @classmethod
    def of(cls, header: Mapping[str, Statement], keys: Sequence[str]) -> Section | None:
        """Return the first of several keywords that holds a section; None where none does."""
        for key in keys:
            found = _SECTION.fullmatch(str(header[key].written).strip()) if key in header else None
            if found is not None and all(int(end) > 0 for end in found.groups()):
                x1, x2, y1, y2 = (int(end) for end in found.groups())
                return cls(min(x1, x2) - 1, min(y1, y2) - 1, abs(x2 - x1) + 1, abs(y2 - y1) + 1, x2 < x1, y2 < y1)
        return None

    def fits(self, shape: tuple[int, int]) -> bool:
        """Return whether it is wholly within a picture of (height, width)."""
        return self.x + self.width <= shape[1] and self.y + self.height <= shape[0]

    def turned(self, on: Section, shape: tuple[int, ...]) -> Section:
        """Return it in a picture of (height, width) that is turned where the ranges of its place fall."""
        x = shape[1] - self.x - self.width if on.x_falls else self.x
        y = shape[0] - self.y - self.height if on.y_falls else self.y
        return self._replace(x=x, y=y)

    def moved(self, x: int, y: int) -> Section:
        """Return it in a larger picture, whose part at (x, y) it counts in."""
        return self._replace(x=self.x + x, y=self.y + y)


def taps_of(header: Mapping[str, Statement], shape: tuple[int, int], doubts: list[str]) -> tuple[TapDescription, ...]:
    """Return the taps that the header of one picture of (height, width) states; empty where it states none."""
    suffixes = sorted({found[1] for key in header if (found := _SUFFIX.fullmatch(key))})
    taps = []
    for suffix in suffixes or [""]:
        data = Section.of(header, [f"{key}{_}{suffix}" for key in _DATA for _ in ("", "_")])
        if data is None:
            continue
        if not data.fits(shape):
            doubts.append(f"the data section{' ' + suffix if suffix else ''} reaches beyond the picture: not used")
            continue
        overscan = Section.of(header, [f"{key}{_}{suffix}" for key in _OVERSCAN for _ in ("", "_")])
        taps.append(_tap(suffix or "1", data, overscan if overscan and overscan.fits(shape) else None, None))
    whole = len(taps) == 1 and (taps[0].width, taps[0].height) == shape[::-1]
    return () if whole else tuple(taps)


def _tap(name: str, data: Section, overscan: Section | None, corner: str | None) -> TapDescription:
    return TapDescription(
        name=name, x=data.x, y=data.y, width=data.width, height=data.height,
        overscan=(tuple(overscan[:4]),) if overscan else (), first_pixel=corner,
    )  # fmt: skip


class Mosaic(NamedTuple):
    """One frame whose amplifiers are separate units of a file, laid next to each other as the detector has them.

    A unit that is read from the other end is turned, so that the frame is a picture but for the overscan in it.
    """

    places: tuple[tuple[int, int], ...]  # (row, column) of each unit, in the order of the file
    turned: tuple[tuple[bool, bool], ...]  # whether its rows and its columns are turned
    unit_shape: tuple[int, int]
    taps: tuple[TapDescription, ...]

    @classmethod
    def of(cls, headers: Sequence[Mapping[str, Statement]], shapes: Sequence[tuple[int, ...]]) -> Mosaic | None:
        """Return how units make one frame: two or more of one size, each at another place of the detector."""
        sections = [Section.of(header, _OF_DETECTOR) for header in headers]
        if len(shapes) < 2 or len(set(shapes)) > 1 or len(shapes[0]) != 2 or None in sections:
            return None
        known = [section for section in sections if section is not None]
        columns, rows = sorted({section.x for section in known}), sorted({section.y for section in known})
        places = tuple((rows.index(section.y), columns.index(section.x)) for section in known)
        if len(set(places)) < len(places) or len(places) != len(rows) * len(columns):
            return None
        height, width = shapes[0]
        taps = []
        for number, (header, (row, column), on) in enumerate(zip(headers, places, known, strict=True), 1):
            data = Section.of(header, _DATA) or Section(0, 0, width, height, False, False)
            overscan = Section.of(header, _OVERSCAN)
            if not data.fits((height, width)):
                return None
            if overscan is not None:
                overscan = overscan.turned(on, shapes[0]).moved(column * width, row * height)
            corner = f"{'lower' if on.y_falls else 'upper'} {'right' if on.x_falls else 'left'}"
            name = str(header["EXTNAME"].written).strip() if "EXTNAME" in header else str(number)
            data = data.turned(on, shapes[0]).moved(column * width, row * height)
            taps.append(_tap(name, data, overscan, corner))
        return cls(places, tuple((on.y_falls, on.x_falls) for on in known), (height, width), tuple(taps))

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) of the frame."""
        rows, columns = (1 + max(place[axis] for place in self.places) for axis in (0, 1))
        return rows * self.unit_shape[0], columns * self.unit_shape[1]

    def laid(self, pictures: Sequence[NDArray[Any]], path: Path) -> NDArray[Any]:
        """Return the frame from the units' pictures. Raises CaptureError if one has another type of numbers."""
        if len({picture.dtype for picture in pictures}) > 1:
            raise CaptureError(f"{path}: its amplifiers are stored in different types of numbers")
        height, width = self.unit_shape
        frame = np.zeros(self.shape, dtype=pictures[0].dtype)
        for (row, column), (rows, columns), picture in zip(self.places, self.turned, pictures, strict=True):
            part = picture[:: -1 if rows else 1, :: -1 if columns else 1]
            frame[row * height : (row + 1) * height, column * width : (column + 1) * width] = part
        return frame
