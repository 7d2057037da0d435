"""Numbers as every face writes them: two digits of the expanded uncertainty, one spelling of each unit, k stated."""

from __future__ import annotations

import math
import re
from typing import Final

_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_KINDS_OF_LIGHT: Final = ("scotopic", "photopic")  # stand before a unit, are no part of it
_PER_ONE: Final = re.compile(r"^(\S*[^\s\d]|log10) ([A-Za-z]+)-1$")
_MICRO: Final = re.compile(r"\bu(?=[ms]\b|[ms]-?\d)")
_MOST_DECIMALS: Final = 7  # more zeros behind the point are hard to count: a power of ten follows
ONE_SIDED_95: Final = 1.645  # of a normal distribution: the limit that 95 % of it is below


def rounded(value: float, expanded: float, apart: float = math.inf) -> tuple[str, str]:
    """Return a value and its expanded uncertainty, both to two digits of the uncertainty.

    Args:
        value: The value.
        expanded: Its expanded uncertainty, same unit; where it is unknown, the value has five digits and it is "–".
        apart: Difference from another value that shares most of the uncertainty: where it is smaller, its two digits
            are shown.
    """
    if not (math.isfinite(expanded) and expanded > 0 and math.isfinite(value)):
        return f"{value:.5g}", "–"
    decimals = _decimals(min(expanded, apart))
    if decimals > _MOST_DECIMALS:
        power = _power(value, expanded)
        scaled = [f"{v / 10.0**power:.{max(0, decimals + power)}f}e{power:+03d}" for v in (value, expanded)]
        return scaled[0], scaled[1]
    shown = max(0, decimals)
    # Adding 0 takes the sign off a value that rounds to zero.
    return f"{round(value, decimals) + 0.0:.{shown}f}", f"{round(expanded, decimals):.{shown}f}"


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: W sr-1 m-2 as W·sr⁻¹·m⁻², e- s-1 as e⁻/s; nothing for the unit 1.

    One quantity per another has a stroke, so that "e- s-1" and "e-/s" are printed alike.
    """
    if unit == "1" or " per " in unit:  # a unit in words is printed as it is
        return "" if unit == "1" else unit
    kind = next((one for one in _KINDS_OF_LIGHT if unit.startswith(one + " ")), None)
    if kind is not None:
        return f"{kind} {unit_text(unit.removeprefix(kind + ' '))}"
    unit = _MICRO.sub("µ", _PER_ONE.sub(r"\1/\2", unit))
    raised = re.sub(r"(?<=[A-Za-z])(?<!log)-?\d+", lambda power: power[0].translate(_RAISED), unit)
    return re.sub(r"e-(?![\w])", "e⁻", raised).replace(" ", "·").replace("log10", "log₁₀")


def with_u(value: float, expanded: float, unit: str = "", k: float | None = None, apart: float = math.inf) -> str:
    """Return "value ± U unit (k = 2)", to two digits of U; without ± where there is no uncertainty.

    An uncertainty of 100 or more has its two digits before a power of ten: (4.10 ± 0.78)·10³.

    Args:
        value: The value.
        expanded: Its expanded uncertainty, same unit.
        unit: Unit, in the form of the files ("W sr-1 m-2") or as it is printed.
        k: Coverage factor of the expanded uncertainty; None where it is stated once for all.
        apart: As for `rounded`.
    """
    printed = unit_text(unit)
    behind = (f" {printed}" if printed else "") + ("" if k is None else f" (k = {k:.3g})")
    shown, u = rounded(value, expanded, apart)
    if u == "–":
        return f"{shown}{f' {printed}' if printed else ''}"
    if expanded >= 99.5 or "e" in shown:
        power = _power(value, expanded)
        digits = max(0, _decimals(min(expanded, apart)) + power)
        shown, u = (f"{round(number / 10.0**power, digits) + 0.0:.{digits}f}" for number in (value, expanded))
        return f"({shown} ± {u})·10{str(power).translate(_RAISED)}{behind}"
    return f"({shown} ± {u}){behind}" if printed.startswith(("%", "°")) else f"{shown} ± {u}{behind}"


def upper_limit(value: float, u: float) -> float:
    """Return what a quantity that is not negative is below with a probability of 95 %.

    Args:
        value: Estimate, same unit; one below 0 counts as 0, so that noise makes no limit lower than it can show.
        u: Its standard uncertainty.
    """
    return max(value, 0.0) + ONE_SIDED_95 * u


def lower_limit(value: float, u: float) -> float:
    """Return what a quantity that is not negative is above with a probability of 95 %.

    Args:
        value: Estimate that the quantity is at least, same unit.
        u: Standard uncertainty of that estimate.
    """
    return max(value - ONE_SIDED_95 * u, 0.0)


def below(limit: float, unit: str = "", *, bare: bool = False) -> str:
    """Return "< limit unit, 95 %", to two digits; bare without both, for where they are stated once for all."""
    decimals = _decimals(limit) if limit > 0 and math.isfinite(limit) else 0
    printed = unit_text(unit)
    shown = f"{limit:.{max(0, decimals)}f}" if decimals <= _MOST_DECIMALS else f"{limit:.2g}"
    if decimals < 0:
        power = _power(limit, limit)
        shown = f"{limit / 10.0**power:.1f}·10{str(power).translate(_RAISED)}"
    return f"< {shown}" if bare else f"< {shown}{f' {printed}' if printed else ''}, 95 %"


def _decimals(expanded: float) -> int:
    """Return how many decimals show two digits of an uncertainty; below 0 where they are all left of the point."""
    decimals = 1 - math.floor(math.log10(expanded))
    # 0.0997 rounds to 0.10, whose two digits end one place earlier.
    return decimals - 1 if round(expanded, decimals) >= 10.0 ** (2 - decimals) else decimals


def _power(value: float, expanded: float) -> int:
    return math.floor(math.log10(max(abs(value), expanded)))
