"""Tables that people keep: separator, header, names of columns as they are spelt, numbers and times as written."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Final

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import read_text
from radiometer.errors import InputError

_SEPARATORS: Final = ",;\t"
_STAMP_FORMS: Final = ("%Y/%m/%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M", "%Y-%m-%d_%H:%M:%S")


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table as it is written.

    Attributes:
        path: Its file.
        header: Names of the columns as they are spelt.
        rows: Line number and cells of each row.
    """

    path: Path
    header: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]

    @property
    def plain(self) -> tuple[str, ...]:
        """Return the names in lower case, with underscores for what is no letter or digit."""
        return tuple(plain_name(name) for name in self.header)

    def find(self, names: Sequence[str]) -> int | None:
        """Return the first column whose plain name is one of these, in their order; None where there is none."""
        for name in names:
            if name in self.plain:
                return self.plain.index(name)
        return None

    def where(self, line: int) -> str:
        """Return file and line, for messages."""
        return f"{self.path}, line {line}"


def plain_name(name: str) -> str:
    """Return a column's name in lower case, units kept, underscores for what is no letter or digit."""
    text = name.strip().lower().replace("µ", "u").replace("²", "2").replace("°", "")
    return "_".join(filter(None, ("".join(c if c.isalnum() else " " for c in text)).split()))


@bounded_reader(error=InputError)
def read_table(path: Path, needs: str) -> TextTable:
    """Return a table with a header; of lines that begin with # the last before the numbers may be the header.

    Args:
        path: CSV with commas, semicolons or tabs.
        needs: What it needs, for messages.

    Raises:
        InputError: If it cannot be read, or holds no table.
    """
    lines = read_text(path).splitlines()
    content = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not content:
        raise InputError(f"{path} is empty; it needs {needs}")
    separator = max(_SEPARATORS, key=content[0][1].count)
    cells = [(n, tuple(c.strip() for c in next(csv.reader([line], delimiter=separator)))) for n, line in content]
    if any(_is_number(cell) for cell in cells[0][1]):
        return TextTable(path, _header_above(path, lines, len(cells[0][1]), needs), tuple(cells))
    return TextTable(path, cells[0][1], tuple(cells[1:]))


def _header_above(path: Path, lines: Sequence[str], width: int, needs: str) -> tuple[str, ...]:
    for line in reversed([line for line in lines if line.lstrip().startswith("#")]):
        for separator in _SEPARATORS:
            names = tuple(name.strip() for name in line.lstrip("# ").split(separator))
            if len(names) == width and not all(_is_number(name) or not name for name in names):
                return names
    raise InputError(f"{path}: has no line that names its columns; it needs {needs}")


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def number(text: str) -> float:
    """Return a number such as 0.004, 1/250, f/8 or 2s. Raises ValueError."""
    cleaned = text.strip().lower().removeprefix("f/").removesuffix("s").strip()
    return float(Fraction(cleaned)) if "/" in cleaned else float(cleaned)


def positive(text: str) -> float:
    """Return a number above zero. Raises ValueError."""
    value = number(text)
    if not value > 0 or not math.isfinite(value):
        raise ValueError(f"{text!r} is not above zero")
    return value


def stamp_s(text: str) -> float:
    """Return a time in s since 1970 UTC from ISO 8601, a date with a time, or a number of s. Raises ValueError."""
    cleaned = text.strip()
    if _is_number(cleaned):
        return float(cleaned)
    try:
        moment = datetime.fromisoformat(cleaned)
    except ValueError:
        moment = _other_form(cleaned)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _other_form(text: str) -> datetime:
    for form in _STAMP_FORMS:
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    raise ValueError(f"{text!r} is no time; write 2026-11-20T22:15:00, or s since 1970")


def column_for(table: TextTable, aliases: Mapping[str, Sequence[str]], key: str, needs: str) -> int:
    """Return the column of a quantity. Raises InputError where the table has none."""
    found = table.find(aliases[key])
    if found is None:
        raise InputError(f"{table.path}: no column {aliases[key][0]!r}; the first line must name {needs}")
    return found
