"""Words of the command line turned into values, with errors that say what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import radiometer as rm
from radiometer.errors import UsageError
from radiometer.plausible import PLAUSIBLE
from radiometer.units import read_number, unit_of

if TYPE_CHECKING:
    from radiometer import Patch

_LONGEST_BARE_EXPOSURE_S: Final = 30.0  # the longest time that shutters offer; 60 and more are meant as 1/60 …
_LARGEST_BARE_F_NUMBER: Final = 90.0  # the smallest aperture of lenses of large-format cameras


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
    return rm.Patch(x, y, width, height)


def parse_seconds(text: str | float, option: str) -> float:
    """Return a time in s from "0.008", "1/125" or "8ms" / "500us".

    Raises:
        UsageError: If it is no time above 0.
    """
    if not isinstance(text, str):
        return text
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


def parse_exposure(text: str, option: str) -> float:
    """Return an exposure time in s as `parse_seconds` does; a bare number above 30 is refused.

    Cameras show 1/125 s as 125, so that a bare 125 may mean either.

    Raises:
        UsageError: If it is no time above 0, or may mean two.
    """
    seconds = parse_seconds(text, option)
    if seconds > _LONGEST_BARE_EXPOSURE_S and text.strip()[-1].isdigit():
        bare = text.strip()
        raise UsageError(f"{option} {bare}: is {bare} s meant, or 1/{bare} s? Write {bare}s or 1/{bare}")
    return seconds


def parse_relative(text: str | float, option: str) -> float:
    """Return a relative quantity from "0.01" or "1%".

    Raises:
        UsageError: If it is no number from 0 to below 1.
    """
    if isinstance(text, float):
        return text
    percent = text.rstrip().endswith("%")
    try:
        number = float(text.rstrip().removesuffix("%")) / (100.0 if percent else 1.0)
    except ValueError as error:
        raise UsageError(f"{option} {text!r}: expected a fraction such as 0.01, or 1%") from error
    if not (math.isfinite(number) and number >= 0.0):
        raise UsageError(f"{option} {text!r}: must be 0 or more")
    if number >= 1.0:
        meant = f"is {100 * number:g} %; write {text.strip()}%, or a fraction below 1"
        way = "must be below 100 %" if percent else meant
        raise UsageError(f"{option} {text.strip()}: {way}")
    return number


def parse_f_number(text: str | float, option: str) -> float:
    """Return an f-number from "4" or "f/4". A bare number above 90 is refused.

    Raises:
        UsageError: If it is no number that a lens can have, or may be an exposure time.
    """
    if isinstance(text, float):
        return text
    low, high = PLAUSIBLE["f_number"].low, PLAUSIBLE["f_number"].high
    bare = text.strip().lower().removeprefix("f/")
    try:
        number = float(bare)
    except ValueError as error:
        hint = "; is it the exposure time?" if "/" in bare else ""
        raise UsageError(f"{option} {text!r}: expected an f-number such as 4 or f/4{hint}") from error
    if number <= 0:
        raise UsageError(f"{option} {text.strip()}: must be above 0")
    if not low <= number <= high:
        hint = "is it the exposure time?" if number < low else "write the aperture's number alone"
        raise UsageError(f"{option} {text.strip()}: f-numbers go from {low:g} to {high:g}; {hint}")
    if number > _LARGEST_BARE_F_NUMBER and bare == text.strip().lower():
        raise UsageError(f"{option} {bare}: is f/{bare} meant, or the exposure time? Write f/{bare}, or correct both")
    return number


def parse_radiance(text: str) -> float | str:
    """Return a radiance in W·sr⁻¹·m⁻², or the name of a certificate.

    Raises:
        UsageError: If it is neither a number nor the name of an XML file.
    """
    if text.lower().endswith(".xml"):
        return text
    try:
        return float(text)
    except ValueError as error:
        raise UsageError(f"--radiance {text!r}: give a number in W·sr⁻¹·m⁻², or a certificate (.xml)") from error


def parse_numbers(text: str, option: str, form: str, count: int | None = None, between: str = ",") -> list[float]:
    """Return the numbers of "1,2,3". Raises UsageError if one is no number, or there is not the count of them.

    Args:
        text: The words.
        option: Option that they are of.
        form: What is expected, for the message.
        count: How many numbers there are; None for any.
        between: What stands between them.
    """
    try:
        found = [float(part) for part in text.lower().split(between)]
    except ValueError:
        found = []
    if not found or count not in (None, len(found)):
        raise UsageError(f"{option} {text!r}: expected {form}")
    return found


def parse_size(text: str) -> tuple[float, ...]:
    """Return the lengths of "0.52x0.32" or of a diameter "0.1". Raises UsageError."""
    form = "WIDTHxHEIGHT in m, such as 0.52x0.32, or a diameter"
    return tuple(parse_numbers(text.replace("×", "x"), "--size", form, between="x"))


def parse_bounds(text: str, option: str) -> tuple[float, float]:
    """Return the two numbers of "LOW,HIGH". Raises UsageError if they are not two numbers with 0 < LOW < HIGH."""
    low, high = parse_numbers(text, option, "LOW,HIGH, such as 0.1,1000", 2)
    if not 0.0 < low < high < math.inf:
        raise UsageError(f"{option} {text!r}: needs 0 < LOW < HIGH")
    return low, high


def parse_measured_iso(words: Sequence[str]) -> dict[float, float]:
    """Return measured ISO speeds by stated ones from words such as "200=136".

    Raises:
        UsageError: If a word is not two numbers above 0, or a speed is given twice.
    """
    return _pairs(words, "--measured-iso", "STATED=REAL with speeds above 0, such as 200=136", 0.0)


def parse_known_ratios(words: Sequence[str]) -> dict[int, float]:
    """Return known exposure ratios by the index of the pair of frames, from words such as "3=2.0".

    Raises:
        UsageError: If a word is no whole number and ratio above 1, or a pair is given twice.
    """
    expected = "PAIR=RATIO with a whole number from 0 and a ratio above 1, such as 3=2.0"
    found = _pairs(words, "--known-ratio", expected, 1.0)
    if any(pair != int(pair) or pair < 0 for pair in found):
        raise UsageError(f"--known-ratio: expected {expected}")
    return {int(pair): ratio for pair, ratio in found.items()}


def parse_named(words: Sequence[str], option: str, between: str, expected: str) -> dict[str, str]:
    """Return texts by name. Raises UsageError for a word that is no name and text, or a name that occurs twice."""
    found = dict[str, str]()
    for word in words:
        name, sign, text = word.partition(between)
        if not (name and sign and text) or name in found:
            raise UsageError(f"{option} {word!r}: expected {expected}; each name once")
        found[name] = text
    return found


def _pairs(words: Sequence[str], option: str, expected: str, above: float) -> dict[float, float]:
    found: dict[float, float] = {}
    for word in words:
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
