"""Words of the command line turned into values, with errors that say what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from radiometer.data.reading import Patch
from radiometer.errors import UsageError
from radiometer.units import read_number, unit_of


def parse_patch(text: str) -> Patch:
    """Return the patch behind "X,Y,W,H" in pixels.

    Raises:
        UsageError: If it is not four whole numbers of which the size is above 0.
    """
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--patch {text!r}: expected X,Y,W,H in whole pixels, such as 100,80,40,40") from error
    if x < 0 or y < 0 or width < 1 or height < 1:
        raise UsageError(f"--patch {text!r}: X and Y must be at least 0, W and H at least 1")
    return Patch(x, y, width, height)


def parse_seconds(text: str, option: str) -> float:
    """Return a time in s from "0.008", "1/125" or "8ms" / "500us".

    Raises:
        UsageError: If it is no time above 0.
    """
    try:
        number, spelling = read_number(text)
    except ValueError as error:
        raise UsageError(f"{option} {text!r}: expected a time such as 0.008, 1/125, 8ms or 500us") from error
    unit = unit_of(spelling or "s", "exposure")
    if unit is None:
        raise UsageError(f"{option} {text!r}: {spelling!r} is no unit of time; use s, ms, us, ns or min")
    seconds = unit.to_base(number)
    if not (math.isfinite(seconds) and seconds > 0):
        raise UsageError(f"{option} {text!r}: a time must be above 0")
    return seconds


def parse_bounds(text: str, option: str) -> tuple[float, float]:
    """Return the two numbers of "LOW,HIGH".

    Raises:
        UsageError: If they are not two numbers with 0 < LOW < HIGH.
    """
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text!r}: expected LOW,HIGH, such as 0.1,1000") from error
    if not 0.0 < low < high < math.inf:
        raise UsageError(f"{option} {text!r}: needs 0 < LOW < HIGH")
    return low, high


F_NUMBER_HELP: Final = "f-number (1 of a lens whose iris cannot change) where the frames or the bench do not state it."


UNSTATED_ISO_HELP: Final = "Photographs: ISO speed of those that state none."
ISO_HELP: Final = "Photographs: ISO speed stated as STATED is really REAL, such as 200=136; may be repeated."


def parse_measured_iso(words: Sequence[str] | None) -> dict[float, float]:
    """Return measured ISO speeds by stated ones from words such as "200=136".

    Raises:
        UsageError: If a word is not two numbers above 0, or a speed is given twice.
    """
    return _pairs(words, "--measured-iso", "STATED=REAL with speeds above 0, such as 200=136", 0.0)


def parse_known_ratios(words: Sequence[str] | None) -> dict[int, float]:
    """Return known exposure ratios by the index of the pair of frames, from words such as "3=2.0".

    Raises:
        UsageError: If a word is no whole number and ratio above 1, or a pair is given twice.
    """
    expected = "PAIR=RATIO with a whole number from 0 and a ratio above 1, such as 3=2.0"
    found = _pairs(words, "--known-ratio", expected, 1.0)
    if any(pair != int(pair) or pair < 0 for pair in found):
        raise UsageError(f"--known-ratio: expected {expected}")
    return {int(pair): ratio for pair, ratio in found.items()}


def _pairs(words: Sequence[str] | None, option: str, expected: str, above: float) -> dict[float, float]:
    found: dict[float, float] = {}
    for word in words or ():
        try:
            key, value = (float(part) for part in word.split("="))
        except ValueError as error:
            raise UsageError(f"{option} {word!r}: expected {expected}") from error
        if not (0.0 <= key < math.inf and above < value < math.inf):
            raise UsageError(f"{option} {word!r}: expected {expected}")
        if key in found:
            raise UsageError(f"{option} {word!r}: {key:g} is given twice")
        found[key] = value
    return found
