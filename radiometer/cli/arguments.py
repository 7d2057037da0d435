"""Words of the command line turned into values, with errors that say what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from radiometer.data.reading import Patch
from radiometer.errors import UsageError
from radiometer.units import exact_f_number

# Printed f-numbers lie this near to the exact stop behind them.
_SAME_STOP_REL: Final = 0.03

if TYPE_CHECKING:
    from radiometer.data import Bracket, Calibration
    from radiometer.data.iso_speeds import IsoSpeeds


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


F_NUMBER_HELP: Final = "f-number (1 of a lens whose iris cannot change) where the frames or the bench do not state it."


def with_f_number(bracket: Bracket, f_number: float | None) -> Bracket:
    """Return the bracket with an f-number stated by hand for the frames that do not state theirs.

    Raises:
        UsageError: If it is not above 0, or frames state another one.
    """
    if f_number is None:
        return bracket
    if not (math.isfinite(f_number) and f_number > 0):
        raise UsageError(f"--f-number {f_number:g}: must be above 0")
    other = {n for frame in bracket.light if (n := frame.settings.f_number) and abs(n / f_number - 1.0) > _SAME_STOP_REL}
    if other:
        raise UsageError(f"--f-number {f_number:g}: the frames state f/{min(other):.4g} themselves; leave it out")
    exact = exact_f_number(f_number)
    number = exact if abs(exact / f_number - 1.0) < _SAME_STOP_REL else f_number
    from radiometer.data import Bracket

    frames = (
        frame if frame.settings.f_number else replace(frame, settings=replace(frame.settings, f_number=number))
        for frame in (*bracket.light, *bracket.dark)
    )
    return Bracket.from_frames(frames, origin=bracket.origin)


ISO_HELP: Final = "Photographs: ISO speed stated as STATED is really REAL, such as 200=136; may be repeated."


def parse_measured_iso(words: Sequence[str] | None) -> dict[float, float]:
    """Return measured ISO speeds by stated ones from words such as "200=136".

    Raises:
        UsageError: If a word is not two numbers above 0, or a speed is given twice.
    """
    return _pairs(words, "--measured-iso", "STATED=REAL with speeds above 0, such as 200=136", 0.0)


def parse_iso_speeds(words: Sequence[str] | None, calibration: Calibration | None) -> IsoSpeeds:
    """Return the ISO speeds that were measured, beside the one at which a calibration's scale holds.

    Raises:
        UsageError: If a word is not two numbers above 0, or a speed is given twice.
    """
    from radiometer.data.iso_speeds import IsoSpeeds

    measured = parse_measured_iso(words)
    if calibration is None:
        return IsoSpeeds(measured)
    return IsoSpeeds(measured, calibration.scale.iso, calibration.scale.iso_stated)


def parse_known_ratios(words: Sequence[str] | None, methods: Sequence[str]) -> dict[int, float]:
    """Return known exposure ratios by the index of the pair of frames, from words such as "3=2.0".

    Raises:
        UsageError: If a word is no whole number and ratio above 1, a pair is given twice, or no method takes ratios.
    """
    from radiometer.analysis.response.methods import RATIO_METHODS

    expected = "PAIR=RATIO with a whole number from 0 and a ratio above 1, such as 3=2.0"
    found = _pairs(words, "--known-ratio", expected, 1.0)
    if found and not set(methods) & set(RATIO_METHODS):
        raise UsageError(
            f"--known-ratio is for methods that find the ratios themselves: --method {' or '.join(RATIO_METHODS)}"
        )
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
