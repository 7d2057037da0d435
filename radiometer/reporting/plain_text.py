"""Texts from outside (remarks, serial numbers, names of files) as terminals and spreadsheets may show them."""

from __future__ import annotations

import re
from typing import Any, Final

# C0 and C1 without line feed and tab; Unicode's bidirectional overrides and isolates (UAX 9), which hide words
_UNPRINTABLE: Final = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_LINE_END: Final = re.compile("[\n\u2028\u2029]")
_FORMULA: Final = ("=", "+", "-", "@", "\t")
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def printable(text: str) -> str:
    """Return a text from outside as a terminal may show it, control characters written as \\x1b.

    So are those that turn the direction of writing. Line feeds and tabs stay.
    """
    return _UNPRINTABLE.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


def one_line(text: str) -> str:
    """Return a text that may hold names from outside as one line of a terminal: line ends are written as \\x0a, too."""
    return _LINE_END.sub(lambda found: f"\\x{ord(found[0]):02x}", printable(text))


def spreadsheet_cell(value: Any) -> Any:
    """Return a value for a cell of a CSV file: a text that a spreadsheet would run as a formula gets an apostrophe.

    Source: OWASP, CSV injection: cells that begin with = + - @, a tab or a carriage return. A number is no formula.
    """
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if text.startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text
