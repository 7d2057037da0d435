"""How replies are written."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable
from typing import Final

from radiometer.data import Reading

_ASCII: Final = str.maketrans({"×": "x", "·": " ", "−": "-", "–": "-", "±": "+-", "μ": "u", "°": ""})  # after NFKD
NOT_A_NUMBER = "9.91E+37"  # SCPI-99, volume 1, 7.2.1.5
INFINITY = "9.9E+37"


def number(value: float) -> str:
    """Return a number as <NR3 NUMERIC RESPONSE DATA> with ten digits."""
    if math.isnan(value):
        return NOT_A_NUMBER
    if math.isinf(value):
        return INFINITY if value > 0 else "-" + INFINITY
    return f"{value:.9E}"


def string(text: str, longest: int | None = None) -> str:
    """Return <STRING RESPONSE DATA>: in quotes, quotes doubled, one line of ASCII; W·sr⁻¹ as W sr-1, ± as +-.

    Args:
        longest: Characters between the quotes at most; None for all.
    """
    plain = unicodedata.normalize("NFKD", text).translate(_ASCII)
    clean = "".join(char if " " <= char <= "~" else "?" for char in plain)
    return '"' + clean[:longest].replace('"', '""') + '"'


def block(content: bytes) -> str:
    """Return <DEFINITE LENGTH ARBITRARY BLOCK RESPONSE DATA>, its bytes decoded as Latin-1."""
    length = str(len(content))
    return f"#{len(length)}{length}" + content.decode("latin-1")


def words(entries: Iterable[object]) -> str:
    """Return entries separated by commas."""
    return ",".join(map(str, entries))


def reading_elements(reading: Reading, function: str, elements: Iterable[str]) -> str:
    """Return the chosen elements of a reading.

    Args:
        function: "RADiance" or "LUMinance".
        elements: Out of READing, UNCertainty, EXPanded, COVerage, TIME, SEQuence, FLAGs.
    """
    return ",".join(_element(reading, function, element) for element in elements)


def _element(reading: Reading, function: str, element: str) -> str:
    quantity = reading.radiance if function == "RADiance" else reading.luminance
    match element:
        case "READing":
            return number(quantity.value if quantity else math.nan)
        case "UNCertainty":
            return number(quantity.u if quantity else math.nan)
        case "EXPanded":
            return number(reading.coverage_factor * quantity.u if quantity else math.nan)
        case "COVerage":
            return number(reading.coverage_factor)
        case "TIME":
            return string(reading.time)
        case "SEQuence":
            return str(reading.sequence)
        case _:
            return string(" ".join(map(str, reading.flags)))
