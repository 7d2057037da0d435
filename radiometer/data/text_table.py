"""Reads tables of text that people keep: the one reader of all CSV and other column files.

Separator and decimal mark are those under which whole columns are numbers, and both are reported. Columns are found by
their names; where a table has no heading, the caller's documented order counts. What is ambiguous is refused.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Final

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import FACTS, Place, Statement, StatementMap, is_unknown, unit_stated, value_of
from radiometer.errors import InputError, UnsettledError
from radiometer.moments import moment_of
from radiometer.plausible import LARGEST
from radiometer.units import Unit, heading_parts, plain_name, unit_of

_SEPARATORS: Final = {"\t": "tabs", ";": "semicolons", ",": "commas", "": "blanks"}
_LONGEST_LINE: Final = 100_000  # Python's csv takes cells of up to 131 072 characters
_LONGEST_CELL: Final = 4_000  # a remark; what looks for units in a heading takes a time that grows with its square
_COMMENT_SIGNS: Final = "#%!"
# The last is Fortran's, which leaves out the E of an exponent of three digits.
_POINT: Final = re.compile(r"[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|\d*\.\d+[-+]\d{3})")
_COMMA: Final = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_THOUSANDS: Final = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")
# With both signs the last one is the decimal mark: 1.234,5 and 1,234.5.
_GROUPED_COMMA: Final = re.compile(r"[-+]?\d{1,3}(?:\.\d{3})+,\d+")
_GROUPED_POINT: Final = re.compile(r"[-+]?\d{1,3}(?:,\d{3})+\.\d+")
# Signs that part thousands and are nothing else between digits: no-break blanks and the Swiss apostrophe.
_GROUP_SIGN: Final = re.compile("(?<=\\d)[\u00a0\u202f'\u2019](?=\\d{3}(?!\\d))")
_STAMP_FORMS: Final = ("%Y/%m/%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M", "%Y-%m-%d_%H:%M:%S")
# What rows may be of: to pool them is to mix curves or scenes.
_OF_WHAT: Final = (
    "subject", "participant", "patient", "person", "eye", "visit", "channel", "filter", "camera", "serial", "sensor",
    "display", "monitor", "screen", "device", "lamp", "colour_channel", "bayer",
)  # fmt: skip
# A running number says nothing of what was measured.
_INDEX_NAMES: Final = ("no", "nr", "number", "index", "row", "sample", "sample_id", "id", "n", "i", "patch", "step", "")


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table as it is written."""

    path: Path  # its file
    header: tuple[str, ...]  # names of the columns as they are spelt; () where the table has no heading
    rows: tuple[tuple[int, tuple[str, ...]], ...]  # line number and cells of each row; numbers have decimal points
    how: str = ""  # how it was read, such as "columns separated by semicolons, decimal commas"
    comments: tuple[str, ...] = ()  # its comment lines without their sign
    preamble: tuple[str, ...] = ()  # lines before the heading that are no part of the table

    @property
    def width(self) -> int:
        """Return the number of columns."""
        return len(self.header) or (len(self.rows[0][1]) if self.rows else 0)

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

    def find_fact(
        self, fact: str, names: Sequence[str], mapped: StatementMap | None = None, *, unit_alone: bool = True
    ) -> int | None:
        """Return the column of a fact: the mapped one, else the one of a known name with or without a unit behind it.

        Args:
            fact: A key of `FACTS`.
            names: Plain names without units, the best first.
            mapped: Where the user states that facts stand.
            unit_alone: Whether a heading that is nothing but a unit of the fact counts, last.

        Raises:
            UnsettledError: If the user names a column that the table has not, or several columns have one of the names.
        """
        if place := self._mapped(fact, mapped):
            return self._named(place.name, fact)
        bare = [(*heading_parts(name, FACTS[fact]), plain_name(name)) for name in self.header]
        for known in (*names, *([""] if unit_alone else [])):
            at = [n for n, (name, _, _, whole) in enumerate(bare) if known in ((name, whole) if known else (name,))]
            at = [n for n in at if known or bare[n][1] is not None]
            if len(at) > 1:
                both = " and ".join(repr(self.header[n]) for n in at)
                way_out = "rename one" if mapped is None else f"name one: --map {fact}=COLUMN"
                raise UnsettledError(f"{self.path}: {both} may both be {fact}; {way_out}")
            if at:
                return at[0]
        return None

    def values(
        self, at: int, fact: str, doubts: list[str], mapped: StatementMap | None = None, defined: str = ""
    ) -> list[float | None]:
        """Return a column in the base unit of a fact; None in rows that state it as unknown.

        Args:
            at: The column.
            fact: A key of `FACTS`.
            doubts: Lines to which is added what is reported.
            mapped: Where the user states that facts stand.
            defined: Unit that the table's documented form gives where the heading has none; "" where it gives none.

        Raises:
            UnsettledError: If no unit is stated or defined.
            InputError: If a cell is no number; the message names line and column.
        """
        heading = self.header[at] if self.header else f"column {at + 1}"
        place = self._mapped(fact, mapped)
        stated = self._unit_text(heading, fact, place)
        found = []
        for line, cells in self.rows:
            cell = cells[at]
            if not is_unknown(cell) and not _is_number(cell) and "/" not in cell and not _has_unit(cell, fact):
                raise InputError(
                    f"{self.where(line)}: {heading}: {cell!r} is no number; correct it, or leave the row out"
                )
            reported: list[str] = []
            found.append(
                value_of(
                    Statement(cell, stated),
                    fact,
                    heading,
                    reported,
                    defined=defined,
                    where=str(self.path),
                    has_option=mapped is not None,
                )
            )
            doubts += [f"{doubt} (line {line})" for doubt in reported]
        return found

    def unit(self, at: int, fact: str, mapped: StatementMap) -> Unit:
        """Return the unit of a whole column, as the user or its heading states it.

        Raises:
            UnsettledError: If none is stated; the message names the option.
        """
        written = self.rows[0][1][at] if self.rows else ""
        stated = self._unit_text(self.header[at], fact, self._mapped(fact, mapped))
        return unit_stated(Statement(written, stated), "", fact, self.header[at], where=str(self.path))

    @staticmethod
    def _unit_text(heading: str, fact: str, place: Place | None) -> str:
        """Return a column's unit as it is spelt, the user's word first; "" where none is stated."""
        _, unit, spelling = heading_parts(heading, FACTS[fact])
        return place.unit if place and place.unit else spelling if unit is not None or _may_be_unit(spelling) else ""

    def numbers(self, at: int) -> list[float]:
        """Return a column whose unit does not matter. Raises InputError for a cell that is no finite number."""
        found = list[float | None]()
        for line, cells in self.rows:
            try:
                found.append(None if is_unknown(cells[at]) else float(cells[at]))
            except ValueError as error:
                raise InputError(
                    f"{self.where(line)}: {cells[at][:20]!r} is no number; correct it, or leave the row out"
                ) from error
        return finite(found, self, at)

    def written_step(self, at: int) -> tuple[float, float]:
        """Return the step of the decimals in which a column is written, and last less first value, in its own unit.

        Of numbers with an exponent it is that of the largest. (0, 1) where a cell holds more than a number.
        """
        try:
            found = [Decimal(cells[at]) for _, cells in self.rows]
        except InvalidOperation:
            return 0.0, 1.0
        powers = [int(one.as_tuple().exponent) for one in found if one.is_finite()]
        finest = min(powers, default=0)
        if any("e" in cells[at].lower() for _, cells in self.rows):
            digits = max(len(one.as_tuple().digits) for one in found)
            finest = max(one.adjusted() for one in found) - digits + 1
        return 10.0**finest, float(found[-1] - found[0]) or 1.0

    def not_used(self, used: Sequence[int | None]) -> list[str]:
        """Return a line that names the columns that are not among those used; nothing where all are."""
        left = [self.header[n] for n in range(len(self.header)) if n not in used]
        return [f"columns {', '.join(left)}"] if left else []

    def refuse_mixed(self, used: Sequence[int | None] = ()) -> None:
        """Refuse a table whose rows are of several things, such as the curves of two eyes, by a column of their names.

        Args:
            used: Columns that the reader uses; what they state is known.

        Raises:
            InputError: If one of the other columns holds several names.
        """
        for at, name in enumerate(self.plain):
            values = list(dict.fromkeys(cells[at].strip() for _, cells in self.rows if not is_unknown(cells[at])))
            if at not in used and name in _OF_WHAT and len(values) > 1:
                raise InputError(
                    f"{self.path}: its rows are of several ({name}: {', '.join(values[:4])}); write a table of each"
                )

    def is_index(self, at: int) -> bool:
        """Return whether a column is a running number by its name."""
        return bool(self.header) and self.plain[at] in _INDEX_NAMES

    def where(self, line: int) -> str:
        """Return file and line, for messages."""
        return f"{self.path}, line {line}"

    def _mapped(self, fact: str, mapped: StatementMap | None) -> Place | None:
        places = mapped.places.get(fact, ()) if mapped else ()
        here = {name.lower() for name in self.header} | set(self.plain)
        known = next((p for p in places if p.name.lower() in here), None)
        return known or (places[0] if places and mapped and fact in mapped.demanded else None)

    def _named(self, name: str, fact: str) -> int:
        for n, heading in enumerate(self.header):
            if name.lower() in (heading.lower(), plain_name(heading)):
                return n
        raise UnsettledError(
            f"{self.path}: has no column {name!r}, which --map {fact} names; "
            f"it has {', '.join(self.header) or 'no heading'}"
        )


def _may_be_unit(spelling: str) -> bool:
    """Return whether words in brackets look like a unit: short, no remark."""
    return 0 < len(spelling) <= 8 and " " not in spelling


def _has_unit(cell: str, fact: str) -> bool:
    found = re.fullmatch(rf"\s*{_POINT.pattern}\s*(\D.*)", cell)
    return bool(found) and unit_of(found[1], FACTS[fact]) is not None if found else False


@bounded_reader(error=InputError)
def read_table(path: Path, needs: str, text: str | None = None, *, named: bool = False) -> TextTable:
    """Return a table of columns parted by tabs, semicolons, commas or blanks.

    Args:
        path: Its file.
        needs: What it needs, for messages.
        text: Its content, where that is at hand.
        named: Refuse a table whose columns have no names.

    Raises:
        InputError: If it cannot be read, holds no table, or its separator or decimal mark is ambiguous.
    """
    lines = (read_export(path) if text is None else text).splitlines()
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip()]
    comments = tuple(_uncommented(line) for _, line in numbered if _is_comment(line))
    content = [(n, line) for n, line in numbered if not _is_comment(line)]
    forced = None
    if content and (found := re.fullmatch(r"\s*sep=(.)\s*", content[0][1])):  # as Excel writes it
        forced, content = found[1], content[1:]
    if not content:
        raise InputError(f"{path} is empty; it needs {needs}")
    if (long := next((n for n, line in content if len(line) > _LONGEST_LINE), None)) is not None:
        raise InputError(f"{path}, line {long}: longer than {_LONGEST_LINE} characters; this is no table")
    separator = _separator([line for _, line in content], forced)
    cells = [(n, _split(line, separator)) for n, line in content]
    if (long := next((n for n, row in cells if max(map(len, row), default=0) > _LONGEST_CELL), None)) is not None:
        raise InputError(f"{path}, line {long}: a cell of more than {_LONGEST_CELL} characters; this is no table")
    width = Counter(len(row) for _, row in cells).most_common(1)[0][0]
    start = next(n for n, (_, row) in enumerate(cells) if len(row) == width)
    preamble, body = cells[:start], cells[start:]
    for line, row in (*preamble, *body):
        is_data = sum(_is_number(c) or bool(_COMMA.fullmatch(c)) for c in row) >= max(1, len(row) - 1)
        if len(row) != width and (line > body[0][0] or is_data):
            raise _ragged(path, line, row, width, separator)
    header, body = _heading(body)
    if (
        not header
        and preamble
        and _names_rows(preamble[-1][1], width, separator, [line for _, line in content[start:]])
    ):
        header, preamble = ("row", *preamble[-1][1]), preamble[:-1]
    if not header and preamble and len(preamble[-1][1]) > 1:
        raise _ragged(path, *preamble[-1], width, separator)
    if not header:
        header = _heading_above(comments, width)
    if named and not header:
        raise InputError(f"{path}: has no line that names its columns; it needs {needs}")
    commas = _comma_columns(path, [row for _, row in body], separator)
    rows = tuple(
        (n, tuple(_pointed(cell) if at in commas else _ungrouped(cell) for at, cell in enumerate(row)))
        for n, row in body
    )
    mark = "commas" if commas else "points"
    how = f"columns separated by {_SEPARATORS.get(separator, repr(separator))}, decimal {mark}"
    kept = tuple(f"line {n}: {' '.join(row)[:60]}" for n, row in preamble)
    return TextTable(path, header, rows, how, comments, kept)


def read_export(path: Path) -> str:
    """Return the text of a file that a meter's program or a spreadsheet wrote: UTF-8, UTF-16, else Windows-1252.

    Raises:
        InputError: If it cannot be read.
    """
    try:
        return decode_export(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def decode_export(raw: bytes) -> str:
    """Return bytes as text: UTF-16 where they begin with its mark, UTF-8, else Windows-1252 ("cd/m²", "µs")."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def _is_comment(line: str) -> bool:
    return line.lstrip().lstrip('"')[:1] in _COMMENT_SIGNS


def _uncommented(line: str) -> str:
    return line.strip().strip('"').lstrip(_COMMENT_SIGNS).strip()


def _separator(lines: Sequence[str], forced: str | None) -> str:
    """Return the separator under which most columns of most rows are whole numbers."""
    if forced is not None:
        return forced
    sample = lines[-min(len(lines), 200) :]
    return max(_SEPARATORS, key=lambda separator: _fitness(sample, separator))


def _fitness(lines: Sequence[str], separator: str) -> tuple[float, float, int]:
    """Return (share of the last rows of one width, share of cells that are numbers or words, width above 1)."""
    rows = [_split(line, separator) for line in lines]
    width = len(rows[-1])
    if width < 2:
        return (0.0, 0.0, 0)
    same = [row for row in rows if len(row) == width]
    cells = [cell for row in same for cell in row]
    clean = sum(_is_cell(cell, separator) for cell in cells) / len(cells)
    return (len(same) / len(rows) > 0.5 and clean, len(same) / len(rows), 1)


def _is_cell(cell: str, separator: str) -> bool:
    """Return whether a cell is a number, a blank or a word, and not two cells of another separator."""
    if len(cell) > _LONGEST_CELL:
        return False
    if _POINT.fullmatch(cell) or is_unknown(cell):
        return True
    if separator != "," and any(form.fullmatch(cell) for form in (_COMMA, _GROUPED_COMMA, _GROUPED_POINT)):
        return True
    return not re.search(r"[;\t,]", cell) and not re.fullmatch(rf"(?:{_POINT.pattern}\s+)+{_POINT.pattern}", cell)


def _split(line: str, separator: str) -> list[str]:
    if not separator:
        return [cell.strip('"') for cell in line.split()]
    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [_GROUP_SIGN.sub("", cell.strip()) for cell in cells]


def _names_rows(names: Sequence[str], width: int, separator: str, lines: Sequence[str]) -> bool:
    """Return whether a heading names all columns but the first: R's write.table names no column for the row names."""
    quoted = all(line.lstrip().startswith('"') for line in lines)
    return len(names) == width - 1 and (quoted or not separator) and not any(_is_number(name) for name in names)


def _ragged(path: Path, line: int, row: Sequence[str], width: int, separator: str) -> InputError:
    comma = " (decimal commas between commas?)" if separator == "," else ""
    return InputError(
        f"{path}, line {line}: cells: {len(row)}; most lines have {width}{comma}; give all lines one number of cells"
    )


def _heading(body: list[tuple[int, list[str]]]) -> tuple[tuple[str, ...], list[tuple[int, list[str]]]]:
    """Return the names of the columns and the rows below; a second row of units belongs to the names."""
    first = body[0][1]
    if not first or any(_is_number(c) or _COMMA.fullmatch(c) for c in first) or all(is_unknown(c) for c in first):
        return (), body
    names, rest = list(first), body[1:]
    if len(rest) > 1 and not any(_is_number(c) or _COMMA.fullmatch(c) for c in rest[0][1]):
        units = [cell.strip("[]() ") for cell in rest[0][1]]
        if any(units) and all(
            not u
            or any(
                unit_of(u, q)
                for q in ("exposure", "luminance", "wavelength", "level", "temperature", "gain", "black_level")
            )
            for u in units
        ):
            names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
            rest = rest[1:]
    return tuple(names), rest


def _heading_above(comments: Sequence[str], width: int) -> tuple[str, ...]:
    """Return the names in the last comment that has as many as the table has columns; () where none has.

    Of two such comments one after the other the second has the units of the first, as in files of sky meters.
    """
    found = [_names_in(line, width) for line in comments]
    last = max((n for n, names in enumerate(found) if names), default=None)
    if last is None:
        return ()
    return found[last - 1] if last > 0 and found[last - 1] else found[last]


def _names_in(line: str, width: int) -> tuple[str, ...]:
    for separator in filter(None, _SEPARATORS):  # words with blanks between them are a remark
        names = tuple(_split(line, separator))
        if len(names) == width > 1 and not any(_is_number(name) for name in names):
            return names
    return ()


def _comma_columns(path: Path, rows: Sequence[Sequence[str]], separator: str) -> set[int]:
    """Return the columns whose numbers have decimal commas.

    Raises:
        InputError: If points and commas are mixed in a column, or every comma may as well part thousands.
    """
    if separator == ",":
        return set()
    sure, unsure = set[int](), dict[int, str]()
    for at, cells in enumerate(zip(*rows, strict=True)):
        commas = [c for c in cells if any(form.fullmatch(c) for form in (_COMMA, _THOUSANDS, _GROUPED_COMMA))]
        points = [c for c in cells if (_POINT.fullmatch(c) and "." in c) or _GROUPED_POINT.fullmatch(c)]
        if commas and points:
            raise InputError(
                f"{path}: {points[0]!r} has a decimal point, {commas[0]!r} a comma; write all numbers in one way"
            )
        if commas and all(_THOUSANDS.fullmatch(c) for c in commas):
            unsure[at] = commas[0]
        elif commas:
            sure.add(at)
    if unsure and not sure:
        raise InputError(
            f"{path}: the comma in {next(iter(unsure.values()))!r} may be a decimal mark or part thousands; "
            "write decimal points"
        )
    return sure | set(unsure)


def _pointed(cell: str) -> str:
    if _GROUPED_COMMA.fullmatch(cell):
        cell = cell.replace(".", "")
    return cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell


def _ungrouped(cell: str) -> str:
    return cell.replace(",", "") if _GROUPED_POINT.fullmatch(cell) else cell


def _is_number(text: str) -> bool:
    return bool(_POINT.fullmatch(text))


def stamp_s(text: str) -> float:
    """Return a time in s since 1970 UTC from ISO 8601, a date with a time, or a number of s. Raises ValueError."""
    cleaned = text.strip()
    if _is_number(cleaned):
        return float(cleaned)
    try:
        return moment_of(cleaned).timestamp()
    except ValueError:
        return _other_form(cleaned).timestamp()


def _other_form(text: str) -> datetime:
    for form in _STAMP_FORMS:
        try:
            return datetime.strptime(text, form).replace(tzinfo=UTC)
        except ValueError:
            continue
    raise ValueError(f"{text!r} is no time; write 2026-11-20T22:15:00, or s since 1970")


def finite(values: Sequence[float | None], table: TextTable, at: int) -> list[float]:
    """Return values all of which are known. Raises InputError that names the first line whose value is not."""
    for (line, _), value in zip(table.rows, values, strict=True):
        if value is None or not math.isfinite(value):
            raise InputError(
                f"{table.where(line)}: {table.header[at] if table.header else at + 1} is missing; leave the row out"
            )
        if abs(value) > LARGEST:
            raise InputError(f"{table.where(line)}: no quantity has the size {value:g}; correct the power of ten")
    return [float(v) for v in values if v is not None]


__all__ = ["TextTable", "finite", "read_table", "stamp_s"]
