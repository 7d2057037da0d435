"""Reads thresholds as people have them: tables of many forms, R's `Dark`, OPI; and says what it took.

Units are those that the file or the user states. Decibels are 10·log10 of luminance; 0 dB of attenuation is
10 000/π cd·m⁻² in OPI's tables (its `dbTocd`).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.outcome import devices_of
from radiometer.data import text_table
from radiometer.data.event_journal import is_journal, read_events
from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.data.statements import StatementMap
from radiometer.errors import InputError, UnsettledError
from radiometer.units import heading_parts, plain_name, unit_of

TIME_WORDS: Final = ("time", "t", "minutes", "min", "minute", "seconds", "sec", "s", "elapsed", "x", "zeit")
THRESHOLD_WORDS: Final = (
    "threshold", "thrs", "thresholds", "thr", "sensitivity", "log_threshold", "luminance", "attenuation", "y",
    "schwelle",
)  # fmt: skip
LEVEL_WORDS: Final = (*THRESHOLD_WORDS, "level", "stim", "intensity", "db", "log", "log10")
SIGMA_WORDS: Final = ("sigma", "u", "sd", "se", "u_log", "u_threshold", "u_log10_threshold", "u_log10", "stderr")
MISSING: Final = ("", "na", "nan", "null", "none", "inf", "-inf", "-")
OPI_BRIGHTEST_CD_M2: Final = 10_000.0 / math.pi  # 0 dB of the Humphrey Field Analyzer: 10 000 asb
_MOST_ROWS: Final = 1_000_000  # a run of one threshold per second for eleven days
NO_MINUTES_FROM: Final = 121.0  # no test lasts so many minutes

# gzip, bzip2 and xz, in which R packs; its own binary and ASCII forms, with and without the head of `save`.
_BEGINNINGS: Final = (
    b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"RDX2\n", b"RDX3\n", b"RDA2\n", b"RDA3\n", b"X\n", b"A\n3\n", b"A\n2\n",
)  # fmt: skip
_MOST_BYTES: Final = 64_000_000  # unpacked; a study of a hundred runs has less than 1 MB
AS_TEXT: Final = "write.csv(data.frame(time=dark$time, thrs=dark$thrs), 'run.csv')"
_TIME: Final = ("time", "Time", "t")
_THRESHOLD: Final = ("thrs", "thresholds", "threshold", "Thrs")
SEEN_WORDS: Final = ("seen", "response", "answer", "detected")
ONSET_WORDS: Final = ("onset", "onset_s", "presented", "timestamp", "elapsed", "clock", "start", "t", "minutes", "time")
YES: Final = ("true", "t", "1", "yes", "y", "seen")
NO: Final = ("false", "f", "0", "no", "n", "unseen", "not seen")
WIDEST_GAP: Final = 1.5  # times the typical gap: a search that begins anew far off shows little of the threshold


def column_of_answers(header: Sequence[str]) -> int | None:
    """Return the column that says whether a trial was seen; None where there is none."""
    words = [cell.strip().lower() for cell in header]
    return next((words.index(word) for word in SEEN_WORDS if word in words), None)


def column_of_onsets(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]], without: int) -> int:
    """Return the column of when each trial was shown: the first of a known name whose numbers ascend.

    OPI's own `time` is the reaction time in ms: it does not ascend. Raises InputError if there is none.
    """
    stems = [re.sub(r"[^a-z]+", "_", re.sub(r"[\[(].*?[\])]", "", cell.lower())).strip("_") for cell in header]
    for word in ONSET_WORDS:
        for at, stem in enumerate(stems):
            named = stem == word or stem.startswith(word + "_") or stem.endswith("_" + word)
            if at != without and named and _ascends([row[at] for row in rows if at < len(row)]):
                return at
    raise InputError(
        f"{path}: a list of trials ({', '.join(header)}) without the time at which each was shown; OPI's `time` is the "
        "reaction time: add a column `onset_s` with the time since the bleach in s"
    )


def _ascends(cells: Sequence[str]) -> bool:
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        return False
    return values.size > 1 and bool(np.all(np.diff(values) >= 0)) and bool(values[-1] > values[0])


def changes_of_answer(path: Path, trials: NDArray[np.float64], answers: Sequence[str]) -> NDArray[np.float64]:
    """Return time and log10 threshold, shape (m, 2), wherever the answer changes from one trial to the next.

    The brighter of the two levels is the one that was seen, else one of the answers was an error; levels far apart,
    where a search begins anew, are left out. The threshold is midway between the levels, its time between the times.

    Args:
        trials: Times in min, ascending, and log10 levels, shape (n, 2).

    Raises:
        InputError: If an answer is neither yes nor no, or none changes.
    """
    seen = np.array([_answer(path, word) for word in answers])
    level = trials[:, 1]
    rise = np.where(seen[1:], level[1:] - level[:-1], level[:-1] - level[1:])
    changes = (seen[1:] != seen[:-1]) & (rise > 0)
    if not changes.any():
        raise InputError(f"{path}: a list of trials in which the answer never changes between two levels")
    upward = changes & seen[1:]  # from not seen to seen: the steps of the search, not its new beginnings
    typical = float(np.median(rise[upward] if upward.any() else rise[changes]))
    kept = changes & (rise <= WIDEST_GAP * typical)
    middle = 0.5 * (trials[1:] + trials[:-1])
    return np.asarray(middle[kept], dtype=np.float64)


def _answer(path: Path, word: str) -> bool:
    plain = word.strip().strip('"').lower()
    if plain not in YES and plain not in NO:
        raise InputError(f"{path}: the answer {word!r} is neither TRUE nor FALSE")
    return plain in YES


def is_r_file(beginning: bytes) -> bool:
    """Return whether a file with these first bytes is one that R saved."""
    return beginning.startswith(_BEGINNINGS)


@bounded_reader(error=InputError, apart="rdata")
def read_r_lists(
    path: Path, times: tuple[str, ...] = _TIME, thresholds: tuple[str, ...] = _THRESHOLD
) -> tuple[str, tuple[str, list[float]], tuple[str, list[float]]]:
    """Return the one object with times and thresholds in a file of R: its name, and name and numbers of both.

    Args:
        path: What `save`, `saveRDS` or `save(ascii = TRUE)` wrote.
        times: Names that times may have.
        thresholds: Names that thresholds may have.

    Raises:
        InputError: If there is none or several, `rdata` is not installed, or the file is damaged.
    """
    try:
        import rdata
    except ImportError as error:
        raise InputError(
            f"{path}: a file of R; `pip install 'radiometer[r]'` reads it, or write it as text there: {AS_TEXT}"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # classes that it does not know, such as "dark", are read as plain lists
            parsed = rdata.parser.parse_data(unpacked(path, path.read_bytes(), _MOST_BYTES))
            known = rdata.conversion.convert(parsed)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # whatever a damaged file makes the library raise
        raise InputError(f"{path}: R's file cannot be read ({error}); write it as text there: {AS_TEXT}") from error
    found = list(_with_thresholds("", known, times, thresholds))
    if len(found) != 1:
        names = f"{' or '.join(times)} and {' or '.join(thresholds)}"
        problem = f"no object with {names}" if not found else f"several objects: {', '.join(f[0] for f in found)}"
        raise InputError(f"{path}: holds {problem}; write one as text in R: {AS_TEXT}")
    name, when, levels = found[0]
    return name or "it", when, levels


def _with_thresholds(
    name: str, known: Any, times: tuple[str, ...], thresholds: tuple[str, ...]
) -> Iterator[tuple[str, tuple[str, list[float]], tuple[str, list[float]]]]:
    """Yield what has times and thresholds, in lists and data frames and lists of them."""
    if not (isinstance(known, Mapping) or hasattr(known, "columns")):
        return
    keys = list(known)
    time = next((key for key in times if key in keys), None)
    threshold = next((key for key in thresholds if key in keys), None)
    if time is not None and threshold is not None:
        yield name, (time, _numbers(known[time])), (threshold, _numbers(known[threshold]))
    elif isinstance(known, Mapping):
        for key, value in known.items():
            yield from _with_thresholds(f"{name}${key}" if name else str(key), value, times, thresholds)


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in np.asarray(values, dtype=np.float64).ravel()]


@dataclass(frozen=True, slots=True)
class TakenTable:
    """Numbers of a file, turned to minutes and log10, and how."""

    rows: np.ndarray  # time in min, log10 threshold and, where known, its u, in order of time; shape (n, 2) or (n, 3)
    facts: dict[str, str] = field(default_factory=dict)  # what the lines beginning with # say, by lower-case name
    taken: tuple[str, ...] = ()  # what was made of the file, in words


@bounded_reader(error=InputError)
def read_table(path: Path, mapped: StatementMap | None = None) -> TakenTable:
    """Return the thresholds in a file.

    Args:
        path: Four kinds of files are read. Journals of `adapt run`. CSV (comma, semicolon, tab or blanks; point or
            comma in numbers), with or without header and # lines. Files that R writes of a `Dark` list by
            `write.csv`, `write.table`, `dput`, `save` or `saveRDS`. A list of trials, as OPI has them: when, which
            level, seen or not.
        mapped: Where the user states that `time` and `threshold` are, and in which unit.

    Raises:
        InputError: If the file cannot be read or no time and threshold are found in it.
        UnsettledError: If a unit is not stated.
    """
    raw = _raw(path)
    if is_journal(raw):
        return _of_journal(path)
    facts: dict[str, str] = {}
    known = mapped or StatementMap()
    if is_r_file(raw):
        named = [tuple(p.name for p in known.places.get(fact, ())[:1]) for fact in ("time", "threshold")]
        name, *columns = read_r_lists(path, named[0] or _TIME, named[1] or _THRESHOLD)
        header = [heading for heading, _ in columns]
        rows = _paired(path, *([str(number) for number in numbers] for _, numbers in columns))
        how = [f"a file of R: {' and '.join(header)} of {name}"]
    else:
        text = text_table.decode_export(raw)
        lists = _r_lists(path, text)
        if lists is None:
            header, rows, facts, how = _cells(path, text)
        else:
            header, rows = ["time", "thrs"], _paired(path, *lists)
            how = ["an R list with time and thrs (dput of a Dark object)"]
    chosen = _settled(path, header, known)
    return _taken(path, header, rows, facts, how, chosen)


def _paired(path: Path, times: list[str], thresholds: list[str]) -> list[tuple[int, list[str]]]:
    """Return the rows of two lists with their numbers from 1. Raises InputError if one list is longer."""
    if len(times) != len(thresholds):
        raise InputError(f"{path}: its list has {len(times)} times and {len(thresholds)} thresholds")
    return [(number, list(row)) for number, row in enumerate(zip(times, thresholds, strict=True), 1)]


def _settled(path: Path, header: list[str], mapped: StatementMap) -> dict[str, int]:
    """Return the columns that the user names, and write the units that the user states into their headings.

    Raises:
        UnsettledError: If the table has no such column.
    """
    chosen = {}
    for fact in ("time", "threshold"):
        for place in mapped.places.get(fact, ())[:1]:
            names = [(name.lower(), plain_name(name)) for name in header]
            at = next((n for n, name in enumerate(names) if place.name.lower() in name), None)
            if at is None:
                has = ", ".join(header) or "no heading"
                raise UnsettledError(f"{path}: has no column {place.name!r}, which --map {fact} names; it has {has}")
            chosen[fact] = at
            header[at] = f"{fact} ({place.unit})" if place.unit else header[at]
    return chosen


def _of_journal(path: Path) -> TakenTable:
    """Return the thresholds in the journal of a run, finished or not."""
    events = list(read_events(path))
    if not events:
        raise InputError(f"{path} holds no thresholds")
    start = events[0]
    named = ("subject", "eye", "visit", "age_years", "pupil_mm", "simulated", "protocol")
    facts = {name: str(start[name]) for name in named if start.get(name) is not None} | dict(start.get("facts") or {})
    facts |= devices_of(events)
    shared = [str(event["u_scale_log10"]) for event in events if event.get("u_scale_log10")]
    facts |= {"u_scale_log10": shared[-1]} if shared else {}
    void = {event["voids"] for event in events if event["kind"] == "pause"} - {None}
    trials = [e for e in events if e["kind"] == "trial" and e["threshold"] is not None and e["sequence"] not in void]
    if not trials:
        raise InputError(f"{path} holds no thresholds")
    columns = ["minutes", "threshold", *(["u_log10"] if all(e.get("u_log10") for e in trials) else [])]
    ended = next((str(event["verdict"]) for event in events if event["kind"] == "end"), "unfinished")
    how = (f"a journal of `adapt run`: {ended}", "thresholds in log₁₀ scotopic cd·m⁻²")
    return TakenTable(np.array([[float(e[name]) for name in columns] for e in trials]), facts, how)


def _raw(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def _r_lists(path: Path, text: str) -> tuple[list[str], list[str]] | None:
    """Return times and thresholds of a list written by `dput`; None where it is none."""
    found = []
    for name in ("time", "thrs"):
        begun = re.search(rf"\b{name}\s*=\s*c\(", text)
        end = text.find(")", begun.end()) if begun is not None else -1
        span = re.search(rf"\b{name}\s*=\s*(-?\d+)L?:(-?\d+)L?", text)
        if begun is not None and end >= 0:
            found.append([cell.strip().removesuffix("L") for cell in text[begun.end() : end].split(",")])
        elif span is not None:
            low, high = int(span.group(1)), int(span.group(2))
            if high - low >= _MOST_ROWS:
                raise InputError(
                    f"{path}: {name} = {low}:{high} means more than {_MOST_ROWS} values; no run has so many"
                )
            found.append([str(number) for number in range(low, high + 1)])
        else:
            return None
    return found[0], found[1]


def _cells(path: Path, text: str) -> tuple[list[str], list[tuple[int, list[str]]], dict[str, str], list[str]]:
    """Return header (empty where there is none), rows of cells with their line numbers, facts and what was taken."""
    table = text_table.read_table(path, "columns time_min,log10_threshold", text)
    table.refuse_mixed()
    rows = [(number, list(cells)) for number, cells in table.rows]
    return list(table.header), rows, _facts(table.comments), [table.how]


def _facts(comments: Sequence[str]) -> dict[str, str]:
    pairs = (re.split(r"[:=]", comment, maxsplit=1) for comment in comments)
    return {pair[0].strip().lower(): pair[1].strip() for pair in pairs if len(pair) == 2}


def number_of(facts: Mapping[str, str], name: str) -> float | None:
    """Return a fact of a table as a number; None where it is missing or none."""
    return _number(facts.get(name, ""))


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _taken(
    path: Path, header: list[str], body: list[tuple[int, list[str]]], facts: dict[str, str], how: list[str],
    chosen: Mapping[str, int],
) -> TakenTable:  # fmt: skip
    seen = column_of_answers(header)
    if seen is not None:
        return _of_trials(path, header, body, facts, how, seen, chosen)
    columns = _columns(path, header, body, chosen)
    used = [column for column in columns if column is not None]
    rows, left_out = [], 0
    for number, row in body:
        cells = [row[column] if column < len(row) else None for column in used]
        if None in cells:
            raise InputError(f"{path}, line {number}: {len(row)} columns, expected {max(used) + 1}")
        values = [_number(str(cell)) for cell in cells]
        if any(v is None and str(c).lower() in MISSING for v, c in zip(values, cells, strict=True)):
            left_out += 1
            continue
        if None in values:
            raise InputError(f"{path}, line {number}: expected numbers, found {','.join(row)!r}")
        rows.append([float(v) for v in values if v is not None])
    if left_out:
        how.append(f"{left_out} rows without a number left out")
    if not rows:
        raise InputError(f"{path} holds no thresholds")
    table = np.array(rows, dtype=np.float64)
    minutes, time_note = _minutes(path, table[:, 0], header, used[0], facts)
    order = np.argsort(minutes, kind="stable")
    levels, slope, level_note = _log10(path, table[order, 1], header, used[1], facts)
    taken = [minutes[order], levels]
    if table.shape[1] == 3:
        if np.any(table[:, 2] <= 0):
            raise InputError(f"{path}: a standard deviation must be above 0")
        is_log = bool(header) and "log" in header[used[2]].lower()  # such as u_log10_threshold
        taken.append(table[order, 2] * (1.0 if is_log else slope))
    return TakenTable(np.column_stack(taken), facts, (*how, time_note, level_note))


def _of_trials(
    path: Path, header: list[str], body: list[tuple[int, list[str]]], facts: dict[str, str], how: list[str], seen: int,
    chosen: Mapping[str, int],
) -> TakenTable:  # fmt: skip
    """Return the thresholds of a list of trials: where the answer changes between two levels."""
    when = chosen.get("time")
    if when is None:
        when = column_of_onsets(path, header, [row for _, row in body], without=seen)
    words = [_word(cell) for cell in header]
    level = chosen.get("threshold", _position(words, LEVEL_WORDS, without=(when, seen)))
    if level is None:
        raise InputError(f"{path}: a list of trials without a column `level` in its header ({', '.join(header)})")
    kept = [(number, [row[when], row[level]]) for number, row in body]
    named = [f"time {header[when]}", header[level]]
    trials = _taken(path, named, kept, facts, how, {"time": 0, "threshold": 1})
    if len(trials.rows) != len(body):
        raise InputError(f"{path}: a trial without time or level")
    order = np.argsort([float(row[when]) for _, row in body], kind="stable")
    rows = changes_of_answer(path, trials.rows, [body[at][1][seen] for at in order])
    note = f"a list of {len(body)} trials: {len(rows)} thresholds where the answer changes, midway between its levels"
    return TakenTable(rows, facts, (*trials.taken, note))


def _columns(
    path: Path, header: list[str], body: list[tuple[int, list[str]]], chosen: Mapping[str, int]
) -> tuple[int | None, ...]:
    """Return the positions of time, threshold and its u (None where there is none)."""
    width = len(body[0][1]) if body else len(header)
    if not header:
        if width < 2:
            raise InputError(f"{path}: expected columns time_min,log10_threshold")
        return (0, 1, 2) if width > 2 else (0, 1, None)
    words = [_word(cell) for cell in header]
    time = chosen.get("time", _position(words, TIME_WORDS, without=tuple(chosen.values())))
    sigma = _position(words, SIGMA_WORDS, without=tuple(chosen.values()))
    level = chosen.get("threshold", _position(words, LEVEL_WORDS, without=(time, sigma)))
    for found, name in ((time, "time_min"), (level, "log10_threshold")):
        if found is None:
            raise InputError(f"{path}: no column {name} in its header ({', '.join(header)})")
    return (time, level, sigma)


def _word(cell: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"[\[(].*?[\])]", "", cell.lower())).strip("_")


def _position(words: Sequence[str], known: Sequence[str], without: Sequence[int | None] = ()) -> int | None:
    """Return where one of the known words stands, alone or at the beginning or end of a longer one."""
    for name in known:
        for at, word in enumerate(words):
            if at not in without and word == name:
                return at
    for name in known:
        for at, word in enumerate(words):
            if at not in without and len(name) > 1 and (word.startswith(name + "_") or word.endswith("_" + name)):
                return at
    return None


def _minutes(
    path: Path, times: NDArray[np.float64], header: Sequence[str], at: int, facts: Mapping[str, str]
) -> tuple[NDArray[np.float64], str]:
    """Return times in min by the unit that the heading or a # line states, and how they were taken.

    Raises:
        UnsettledError: If neither does.
    """
    heading = header[at] if header else ""
    words = re.sub(r"[^a-z]+", " ", f"{heading} {facts.get('time unit', facts.get('time', ''))}".lower()).split()
    stated = heading_parts(heading, "time")[1] or next((u for w in words if (u := unit_of(w, "time"))), None)
    if stated is not None:
        return times * stated.to_base(1.0) / 60.0, f"time in {stated.name}, as its header states"
    documented = "the documented order" if not header else "as in lists of R's package Dark" if _is_dark(header) else ""
    if not documented or float(times.max()) >= NO_MINUTES_FROM:
        raise _unsettled(path, "time", heading, f"goes to {times.max():g}", "min, s, ms or h", "time_min")
    return times, f"time in min, {documented}"


def _log10(
    path: Path, levels: NDArray[np.float64], header: Sequence[str], at: int, facts: Mapping[str, str]
) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """Return log10 thresholds, their slope per unit of the file, and how they were taken.

    Raises:
        UnsettledError: If no heading and no # line states the unit, or decibels rise that are not of attenuation.
        InputError: If a linear threshold is not above 0.
    """
    heading = header[at] if header else ""
    spelling = _threshold_unit(heading, facts)
    brightest = _number(facts.get("max_cd_m2", facts.get("0 db", "")).split(" ")[0])
    if brightest is None and "opi" in " ".join([*facts, *facts.values(), *header]).lower().split():
        brightest = OPI_BRIGHTEST_CD_M2
    of_attenuation = bool(re.search("sensitivity|attenuation", heading.lower())) or brightest is not None
    why = "as its header states"
    if spelling.lower() in ("db", "decibel", "decibels"):
        edge = max(1, levels.size // 4)
        rises = float(np.median(levels[-edge:])) > float(np.median(levels[:edge]))
        if not of_attenuation and (rises or heading_parts(heading, "threshold")[0] == ""):
            problem = f"is in dB, of attenuation or of luminance, and {'rises' if rises else 'falls'}"
            raise _unsettled(path, "threshold", heading, problem, "dB or 'dB attenuation'", "attenuation_dB")
        spelling = "dB attenuation" if of_attenuation else "dB"
    elif not spelling and (not header or _is_dark(header)):
        spelling, why = "log10", "the documented order" if not header else "as in lists of R's package Dark"
    unit = unit_of(spelling, "threshold") if spelling else None
    if unit is None:
        offered = "log10, ln, dB, 'dB attenuation', cd/m2, td or 'log10 mcd/m2'"
        raise _unsettled(
            path, "threshold", heading, f"has {levels.min():g} to {levels.max():g}", offered, "log10_threshold"
        )
    zero = math.log10(brightest) if spelling == "dB attenuation" and brightest is not None else 0.0
    taken = np.array([unit.to_base(float(v)) for v in levels])
    if not np.isfinite(taken).all():
        raise InputError(f"{path}: a threshold of {levels.min():g} in linear units; they must be above 0")
    is_linear = math.isnan(unit.to_base(-1.0))  # which has no logarithm
    slope = (
        1.0 / (levels * math.log(10.0)) if is_linear else np.full(levels.shape, unit.to_base(1.0) - unit.to_base(0.0))
    )
    of = f"0 dB = {brightest:.5g} cd·m⁻², " if zero else ""
    return taken + zero, np.abs(slope), f"thresholds in {spelling}, {of}{why}: log₁₀ taken"


def _threshold_unit(heading: str, facts: Mapping[str, str]) -> str:
    """Return the unit of thresholds as a spelling of `units.SPELLINGS`; "" where heading and # lines state none."""
    name, unit, spelling = heading_parts(heading, "threshold")
    if unit is None:
        noted = facts.get("threshold unit", facts.get("unit", facts.get("units", "")))
        spelling = noted if unit_of(noted, "threshold") else ""
    law = next((law for word in name.split("_") for sign, law in _LAWS.items() if re.fullmatch(sign, word)), "")
    if law and spelling and unit_of(f"{law} {spelling}", "threshold"):
        return f"{law} {spelling}"
    return spelling or law


_LAWS: Final = {"log.*": "log10", "ln": "ln"}  # by words of a heading: `log threshold (mcd/m2)`


def _is_dark(header: Sequence[str]) -> bool:
    """Return whether a table is a list of R's package Dark: minutes in `time`, log10 thresholds in `thrs`."""
    return {"time", "thrs"} <= {_word(name) for name in header}


def _unsettled(path: Path, fact: str, heading: str, problem: str, units: str, example: str) -> UnsettledError:
    way_out = f"call the column {example}, or read it with --map {fact}={heading}:UNIT (UNIT: {units})"
    if not heading:
        way_out = f"write a heading, such as {example}"
    return UnsettledError(f"{path}: the column of the {fact} {heading!r} states no unit and {problem}: {way_out}")
