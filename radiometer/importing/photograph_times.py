"""Exposure times of photographs: EXIF, or a list next to them."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import read_text
from radiometer.errors import CaptureError, InputError
from radiometer.importing.exif import camera_of, exposure_of, f_number_of, iso_of, read_exif_header
from radiometer.plausible import PLAUSIBLE
from radiometer.units import (
    DIAL_DENOMINATORS,
    LONGEST_OF_DIAL_S,
    exact_exposures_s,
    exact_f_number,
    heading_parts,
    read_number,
    unit_of,
)

_LONGEST_NAME: Final = 1_000  # characters; no file system has names of so many
_GAP: Final = re.compile(r"[,;\s]+")
_DECIMAL_COMMA: Final = re.compile(r"[;\s]+(\d+,\d+\s*[^\W\d]*)\s*(?![,\d])")
_UNITS_OFFERED: Final = "write s, ms, us, ns or min behind the number, or in the heading"
_NAME_COLUMN: Final = ("file", "name", "filename", "image")
_TIME_COLUMN: Final = (
    "time", "exposure", "exposure_time", "exptime", "exp", "seconds", "t", "shutter", "duration", "zeit",
)  # fmt: skip
_FRACTION_WITH_BLANKS: Final = re.compile(r"(?<=\d)\s*/\s*(?=\d)")

LIST_NAMES: Final = ("exposures.txt", "exposures.csv", "image_list.txt")


@dataclass(frozen=True, slots=True)
class PhotographSettings:
    """What is known of one photograph."""

    exposure_s: float  # exposure time in s, exact where `with_exact_times` found a dial
    nominal_exposure_s: float  # the time as printed
    f_number: float | None = None  # exact f-number; None where unknown
    iso: float | None = None  # ISO speed as stated; None where unknown
    gain_db: float = 0.0  # gain in addition to the ISO speed in dB of amplitude
    iso_doubt: str = ""  # why no speed is known though a tag states one; "" where that is not so
    camera: Mapping[str, str | float] = field(default_factory=dict)  # camera, lens, development: as of `camera_of`


@bounded_reader()
def read_exif(path: Path) -> PhotographSettings | None:
    """Return the settings in a photograph's EXIF data, its time as printed; None where it holds no exposure time."""
    header, doubts = read_exif_header(path), list[str]()
    exposure = exposure_of(header, doubts, str(path))
    if exposure is None or exposure[1] == 0:
        return None
    nominal, f_number = exposure[1], f_number_of(header, doubts, str(path))
    doubts.clear()
    iso = iso_of(header, doubts, str(path))
    return PhotographSettings(
        exposure_s=nominal,
        nominal_exposure_s=nominal,
        f_number=None if f_number is None else exact_f_number(f_number),
        iso=None if iso is None else iso[1],
        iso_doubt="; ".join(doubts),
        camera=camera_of(header, str(path)),
    )


def with_exact_times(settings: Mapping[str, PhotographSettings]) -> dict[str, PhotographSettings]:
    """Return photographs of one camera with the exact stops behind their printed times (2⁻⁶ s behind 1/60 s).

    Other cameras' times are no stops, and are as printed.
    """
    exact = exact_exposures_s([one.nominal_exposure_s for one in settings.values()])
    return {
        name: replace(one, exposure_s=seconds) for (name, one), seconds in zip(settings.items(), exact, strict=True)
    }


def find_list(folder: Path) -> Path | None:
    """Return the list of exposure times in a folder; None where there is none."""
    return next((folder / name for name in LIST_NAMES if (folder / name).is_file()), None)


@bounded_reader()
def read_list(path: Path) -> dict[str, PhotographSettings]:
    """Return the settings of every file that a list names.

    One file per line: `name seconds`, separated by blanks or a comma. A fraction such as 1/125 is allowed and used as
    written. A unit (s, ms, us, min) may follow, or be in a heading (`name time_ms`). Lines that begin with # are
    comments; where such a line names the columns and the second one is the shutter speed 1/t (Debevec's image lists
    exist in both forms), its reciprocal is taken.

    Raises:
        CaptureError: If the list is unreadable, empty, names a file twice, or a line is not of that form; names file
            and line.
    """
    lines = _lines(path)
    reciprocal, unit, found, line_of, bare = False, "", dict[str, PhotographSettings](), dict[str, int](), True
    here = names_in(path.parent)
    for number, line in enumerate(lines, start=1):
        text = line.strip().strip("#").strip()
        words = _words(_FRACTION_WITH_BLANKS.sub("/", text), here)
        where = f"{path}, line {number}"
        if not words[0]:
            continue
        if line.lstrip().startswith("#") or (number == 1 and _is_heading(words)):
            is_reciprocal = len(words) > 1 and words[1].lower().startswith(("1/", "shutter_speed"))
            reciprocal |= is_reciprocal
            unit = _unit_of_heading(words, where, is_time=not is_reciprocal) or unit
            continue
        if (before := line_of.setdefault(words[0], number)) != number:
            raise CaptureError(f"{where}: names {words[0]!r} again (as line {before} does); leave one of the lines out")
        _refuse_decimal_comma(text, words, where)
        found[words[0]] = _settings_of_line(words, reciprocal, unit, where)
        bare &= not (reciprocal or unit) and words[1:2] != [] and words[1].isdigit() and len(words) == 2
    _refuse_denominators(path, found, bare)
    if not found:
        raise CaptureError(f"{path}: names no photograph; write one line per file: `name seconds`")
    return found


def _refuse_denominators(path: Path, found: Mapping[str, PhotographSettings], bare: bool) -> None:
    """Refuse whole numbers without a unit that all are on a dial as denominators: 125 may be 1/125 s.

    Raises:
        CaptureError: If all are, and beyond the times of a dial.
    """
    numbers = [one.nominal_exposure_s for one in found.values()]
    if bare and len(numbers) > 1 and min(numbers) > LONGEST_OF_DIAL_S / 2 and set(numbers) <= set(DIAL_DENOMINATORS):
        raise CaptureError(
            f"{path}: {numbers[0]:g} and the others without a unit may be s, or 1/{numbers[0]:g} s as on a dial; write "
            f"{numbers[0]:g}s or 1/{numbers[0]:g}"
        )


def _lines(path: Path) -> list[str]:
    try:
        return read_text(path).splitlines()
    except InputError as error:
        raise CaptureError(f"{error}; save the list as plain text in UTF-8") from error


def names_in(folder: Path) -> dict[str, str]:
    """Return the names of the files in a folder by their composed form: some systems store ü as u and two dots."""
    return {unicodedata.normalize("NFC", entry.name): entry.name for entry in folder.iterdir() if entry.is_file()}


def name_of_other_case(name: str, names: Iterable[str]) -> str | None:
    """Return the one of several names that differs in capital letters alone; None where there is none."""
    return next((other for other in names if other.casefold() == name.casefold()), None)


def _words(line: str, here: dict[str, str]) -> list[str]:
    """Return a line's name and what follows; a name has blanks where a photograph of that name is in the folder."""
    for gap in _GAP.finditer(line[:_LONGEST_NAME]):
        name = _plain_name(line[: gap.start()])
        if name in here:
            return [here[name], *_GAP.split(line[gap.end() :])]
    words = _GAP.split(line)
    return [_plain_name(words[0]), *words[1:]]


def _plain_name(text: str) -> str:
    return unicodedata.normalize("NFC", text.strip("\"'").removeprefix("./"))


def _refuse_decimal_comma(line: str, words: list[str], where: str) -> None:
    """Refuse `name 3,2` and `name;3,2`: the comma would part it into columns, and 3 s be taken."""
    found = _DECIMAL_COMMA.search(line)
    if found is None or _GAP.split(found.group(1).strip()) != words[1:]:
        return
    raise CaptureError(f"{where}: {found.group(1)!r} has a decimal comma; write {found.group(1).replace(',', '.')}")


def _is_heading(words: list[str]) -> bool:
    return len(words) > 1 and _number(words[1]) is None and words[0].lower() in _NAME_COLUMN


def _unit_of_heading(words: list[str], where: str, *, is_time: bool) -> str:
    """Return the unit that a heading gives the second column (`name time_ms`, `file, time (ms)`); "" where none.

    Raises:
        CaptureError: If the second column is no time by its name, or its unit is not known.
    """
    if words[0].lower() not in _NAME_COLUMN or len(words) < 2:
        return ""
    bracketed = len(words) > 2 and words[2][:1] in "(["
    name, unit, spelling = heading_parts(" ".join(words[1:3]) if bracketed else words[1], "exposure")
    if unit is None and spelling:
        raise CaptureError(f"{where}: {spelling!r} is no unit of time; {_UNITS_OFFERED}")
    if is_time and name and name not in _TIME_COLUMN:
        raise CaptureError(
            f"{where}: the second column is {words[1]!r}, which is no exposure time; write `name time` with the time "
            "in s second"
        )
    return spelling


def _settings_of_line(words: list[str], reciprocal: bool, unit: str, where: str) -> PhotographSettings:
    seconds = _time_s(words, unit)
    if seconds is None or not (math.isfinite(seconds) and seconds > 0):
        shown = words[1] if len(words) > 1 else "nothing"
        raise CaptureError(
            f"{where}: {shown!r} after {words[0]!r} is no exposure time; expected seconds above 0, such as 0.5, "
            f"1/125 or 20 ms"
        )
    seconds = PLAUSIBLE["exposure"].check(where, 1.0 / seconds if reciprocal else seconds, CaptureError)
    return PhotographSettings(exposure_s=seconds, nominal_exposure_s=seconds)


def _time_s(words: list[str], unit: str) -> float | None:
    """Return the time in s of a line whose unit is in the time itself, in the word after it, or in the heading."""
    if len(words) < 2:
        return None
    unit_follows = len(words) > 2 and (words[2][:1].isalpha() or unit_of(words[2], "exposure") is not None)
    after = words[2] if unit_follows else ""
    return _number(words[1], after or unit)


def _number(word: str, unit: str = "") -> float | None:
    """Return a time in s, in the given unit where none stands at its end; None where it is no time."""
    try:
        value, own = read_number(word)
    except ValueError:
        return None
    known = unit_of(own or unit or "s", "exposure")
    return None if known is None else known.to_base(value)
