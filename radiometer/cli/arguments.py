"""Words of the command line turned into values, with errors that say what was expected."""

from __future__ import annotations

import math
from fractions import Fraction

from radiometer.data.reading import Patch
from radiometer.errors import UsageError


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
    scale, number = 1.0, text.strip()
    for ending, factor in (("us", 1e-6), ("µs", 1e-6), ("ms", 1e-3), ("s", 1.0)):
        if number.endswith(ending):
            scale, number = factor, number[: -len(ending)].strip()
            break
    try:
        seconds = float(Fraction(number)) * scale if "/" in number else float(number) * scale
    except (ValueError, ZeroDivisionError) as error:
        raise UsageError(f"{option} {text!r}: expected a time such as 0.008, 1/125, 8ms or 500us") from error
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
