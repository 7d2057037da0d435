"""Numbers as a report writes them: as many digits as their uncertainty allows."""

from __future__ import annotations

import math
import re
from typing import Final

_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def rounded(value: float, expanded: float) -> tuple[str, str]:
    """Return a value and its expanded uncertainty, both to two digits of the uncertainty.

    Args:
        expanded: Its expanded uncertainty, same unit; where it says nothing, the value has five digits and it is "–".
    """
    if not (math.isfinite(expanded) and expanded > 0 and math.isfinite(value)):
        return f"{value:.5g}", "–"
    decimals = 1 - math.floor(math.log10(expanded))
    if decimals > 7:
        power = math.floor(math.log10(max(abs(value), expanded)))
        scaled = [f"{v / 10.0**power:.{max(0, decimals + power)}f}e{power:+03d}" for v in (value, expanded)]
        return scaled[0], scaled[1]
    shown = max(0, decimals)
    return f"{round(value, decimals):.{shown}f}", f"{round(expanded, decimals):.{shown}f}"


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: W sr-1 m-2 as W·sr⁻¹·m⁻²; nothing for the unit 1."""
    if unit == "1":
        return ""
    raised = re.sub(r"(?<=[A-Za-z])-?\d+", lambda power: power[0].translate(_RAISED), unit)
    return re.sub(r"e-(?![\w])", "e⁻", raised).replace(" ", "·")


def with_u(value: float, expanded: float, unit: str = "") -> str:
    """Return "value ± U unit", to two digits of U; without ± where there is no uncertainty."""
    shown, u = rounded(value, expanded)
    behind = f" {unit}" if unit else ""
    if "e" in shown and "e" in u:
        (shown, power), u = shown.split("e"), u.partition("e")[0]
        return f"({shown} ± {u})·10{str(int(power)).translate(_RAISED)}{behind}"
    if u == "–":
        return f"{shown}{behind}"
    return f"({shown} ± {u}) {unit}" if unit.startswith(("%", "°")) else f"{shown} ± {u}{behind}"
