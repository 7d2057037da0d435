"""Queries on the journal: filters, export as JSON lines or CSV. Never writes."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from radiometer.daemon.journal import (
    APPLICATION_ID,
    BOUNDS,
    MINUTE_US,
    PLACE_OF,
    SCHEMA_VERSION,
    refuse_foreign_objects,
)
from radiometer.daemon.timestamps import iso_time
from radiometer.data.json_text import parsed_json
from radiometer.data.reader_limits import refuse_endless
from radiometer.data.storage import csv_text
from radiometer.errors import InputError, UsageError
from radiometer.plausible import PLAUSIBLE
from radiometer.reporting.plain_text import spreadsheet_cell

CSV_COLUMNS: Final = (
    "sequence", "time", "instrument", "radiance", "u_radiance", "radiance_unit", "luminance", "u_luminance",
    "luminance_unit", "U_rel", "coverage_factor", "flags", "x", "y", "width", "height", "exposures_s", "name",
    "session",
)  # fmt: skip
_FINE_US: Final = 7_500_000_000  # two hours and a bit: up to here readings, beyond it minutes
_FINE_TREND: Final = f"""
SELECT time_us / ? AS bucket, avg(radiance), avg(coalesce(json_extract(json, '$.radiance.u'), 0)), min(radiance),
    max(radiance), count(*), sum(flags <> ''), json_extract(json, '$.radiance.unit') AS unit,
    {PLACE_OF.format("json")} AS place
FROM (SELECT * FROM readings INDEXED BY readings_by_time
    WHERE stream = ? AND time_us >= ? AND time_us < ? AND radiance IS NOT NULL)
GROUP BY bucket, unit, place ORDER BY bucket, min(time_us)
"""
_COARSE_TREND: Final = """
SELECT minute / ? AS bucket, sum(total) / sum(count), sum(total_u) / sum(count), min(low), max(high), sum(count),
    sum(flagged), unit, place
FROM (SELECT * FROM trend WHERE stream = ? AND minute >= ? AND minute < ?)
GROUP BY bucket, unit, place ORDER BY bucket, min(minute)
"""
_STEPS_BETWEEN_CHECKS: Final = 10_000  # of SQLite's machine: short against any deadline


@dataclass(frozen=True, slots=True)
class ReadingFilter:
    """Which readings are asked for."""

    since_us: int | None = None  # not before this time, µs since 1970; None for no bound
    until_us: int | None = None  # before this time; None for no bound
    after: int | None = None  # sequence number above this; None for no bound
    flag: str | None = None  # only readings with this flag
    without_flags: bool = False  # only readings without any flag
    limit: int | None = None  # at most this many; None for all
    newest_first: bool = False  # take (and give) the newest first
    stream: str | None = None  # only readings of this stream ("" is the patch measured for all); None for all

    def __post_init__(self) -> None:
        for name in ("after", "limit"):
            if (number := getattr(self, name)) is not None:
                PLAUSIBLE["journal_number"].check(name, number, UsageError)

    def where(self) -> tuple[str, list[Any]]:
        """Return the SQL condition and its values."""
        terms, values = ["1"], list[Any]()
        for condition, value in (
            ("time_us >= ?", self.since_us),
            ("time_us < ?", self.until_us),
            ("sequence > ?", self.after),
            ("stream = ?", self.stream),
            ("instr(' ' || flags || ' ', ' ' || ? || ' ') > 0", self.flag),
        ):
            if value is not None:
                terms.append(condition)
                values.append(value)
        if self.without_flags:
            terms.append("flags = ''")
        return " AND ".join(terms), values


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """The readings of a short time, taken together."""

    time_us: int  # middle of that time, µs since 1970
    value: float  # mean radiance
    u: float  # mean of the standard uncertainties: it is mostly the calibration's, so the mean has no smaller one
    low: float  # lowest radiance
    high: float  # highest
    count: int  # how many readings
    flagged: int  # how many of them have a flag
    unit: str  # unit of the radiances
    place: str = ""  # camera and patch that they are of; "at least" or "at most" behind it where they are bounds

    @property
    def bound(self) -> str:
        """Return "at least" where the readings are saturated, "at most" where below the noise; "" for values."""
        return next((bound for bound in BOUNDS.values() if self.place.endswith(bound)), "")


class JournalReader:
    """Reads a journal while a daemon may be writing it.

    Args:
        deadline_s: Longest time in s that one query may take.
    """

    def __init__(self, path: Path, *, deadline_s: float = 60.0) -> None:
        self._path, self._deadline_s = path, deadline_s

    def lines(self, row_filter: ReadingFilter) -> list[str]:
        """Return the JSON lines of the readings asked for, oldest first unless `newest_first`.

        Raises:
            InputError: If there is no journal, it cannot be read or the query takes too long.
        """
        return list(self.iterate(row_filter))

    def iterate(self, row_filter: ReadingFilter) -> Iterator[str]:
        """Yield the JSON lines of the readings asked for. Raises InputError."""
        order = "DESC" if row_filter.newest_first else "ASC"
        limit = -1 if row_filter.limit is None else row_filter.limit
        with self._connect() as connection:
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if version < 2:  # written before there were streams: all of it is the first
                if row_filter.stream:
                    return
                row_filter = replace(row_filter, stream=None)
            condition, values = row_filter.where()
            rows = connection.execute(
                f"SELECT json FROM readings WHERE {condition} ORDER BY sequence {order} LIMIT ?", [*values, limit]
            )
            for (line,) in rows:
                yield line

    def trend(self, stream: str, since_us: int, until_us: int, points: int = 1500) -> list[TrendPoint]:
        """Return the course of a stream, oldest first, as means over times that suit the number of points.

        Readings of two places, where a patch was moved or another camera serves, share no mean, nor do values and
        bounds.

        Args:
            stream: The stream, "" for the patch measured for all.
            since_us: From this time on, µs since 1970.
            until_us: Before this time.
            points: About so many at most.

        Raises:
            InputError: If there is no journal or it cannot be read.
        """
        span_us = max(until_us - since_us, 1)
        with self._connect() as connection:
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if version < SCHEMA_VERSION:
                return []
            if span_us <= _FINE_US:
                bucket_us = max(1, span_us // points)
                query, values = _FINE_TREND, (bucket_us, stream, since_us, until_us)
            else:
                minutes = max(1, span_us // points // MINUTE_US)
                query = _COARSE_TREND
                values = (minutes, stream, since_us // MINUTE_US, -(-until_us // MINUTE_US))
                bucket_us = minutes * MINUTE_US
            rows = connection.execute(query, values).fetchall()
        return [TrendPoint(row[0] * bucket_us + bucket_us // 2, *row[1:]) for row in rows]

    def events(
        self, since_us: int | None = None, limit: int = 1000, until_us: int | None = None, kind: str | None = None
    ) -> list[dict[str, Any]]:
        """Return the newest events of a time, and kind, oldest first, each {time, kind, message}. Raises InputError."""
        with self._connect() as connection:
            rows = connection.execute(
                "SELECT time_us, kind, message FROM events WHERE time_us >= ? AND time_us < ?"
                " AND kind = coalesce(?, kind) ORDER BY id DESC LIMIT ?",
                (since_us or 0, until_us or 2**62, kind, limit),
            ).fetchall()
        return [{"time": iso_time(at), "kind": what, "message": message} for at, what, message in reversed(rows)]

    def budget(self, sequence: int) -> dict[str, float]:
        """Return the relative standard uncertainty per contribution of one reading. Raises InputError."""
        PLAUSIBLE["journal_number"].check(f"reading {sequence} of {self._path}", sequence)
        with self._connect() as connection:
            row = connection.execute("SELECT budget FROM readings WHERE sequence = ?", (sequence,)).fetchone()
        if row is None:
            raise InputError(f"{self._path} holds no reading {sequence}")
        return {str(name): float(u_rel) for name, u_rel in parsed_json(row[0]).items()}

    def known(self, after: int) -> int:
        """Return the number after which a client asks, 0 where it is above the newest: one of another journal.

        Raises:
            InputError: As `lines`.
        """
        with self._connect() as connection:
            (newest,) = connection.execute("SELECT coalesce(max(sequence), 0) FROM readings").fetchone()
        return after if after <= newest else 0

    def bounds(self) -> tuple[int, int, int]:
        """Return lowest and highest sequence number and the count; (0, 0, 0) if empty. Raises InputError."""
        with self._connect() as connection:
            low, high, count = connection.execute(
                "SELECT coalesce(min(sequence), 0), coalesce(max(sequence), 0), count(*) FROM readings"
            ).fetchone()
        return int(low), int(high), int(count)

    @contextmanager
    def _connect(self) -> Iterator[sqlite3.Connection]:
        if not self._path.is_file():
            refuse_endless(self._path)
            raise InputError(
                f"there is no journal {self._path}; `radiometer serve` writes one, --journal names another"
            )
        give_up_at = time.monotonic() + self._deadline_s
        try:
            connection = sqlite3.connect(f"file:{quote(str(self._path.resolve()))}?mode=ro", uri=True, timeout=2.0)
            try:
                connection.set_progress_handler(lambda: time.monotonic() > give_up_at, _STEPS_BETWEEN_CHECKS)
                (application_id,) = connection.execute("PRAGMA application_id").fetchone()
                if application_id != APPLICATION_ID:
                    raise InputError(f"{self._path} is an SQLite file but not a radiometer journal")
                refuse_foreign_objects(connection, self._path, InputError)
                yield connection
            finally:
                connection.close()
        except sqlite3.Error as error:
            if time.monotonic() > give_up_at:
                raise InputError(
                    f"{self._path}: the query takes more than {max(self._deadline_s, 0.0):g} s; ask for a shorter time"
                ) from error
            raise InputError(f"cannot read the journal {self._path}: {error}") from error


def to_csv(lines: Iterable[str], *, header: bool = True) -> str:
    """Return readings, given as JSON lines, as CSV with (or without) a header line."""
    return csv_text([*([CSV_COLUMNS] if header else []), *map(_csv_row, lines)])


def _csv_row(line: str) -> list[Any]:
    reading = parsed_json(line)
    radiance, luminance, patch = reading["radiance"], reading["luminance"] or {}, reading["patch"]
    cells = [
        reading["sequence"], reading["time"], reading["instrument"], radiance["value"], radiance["u"],
        radiance["unit"], luminance.get("value", ""), luminance.get("u", ""), luminance.get("unit", ""),
        reading["U_rel"], reading["coverage_factor"], " ".join(reading["flags"]), patch["x"], patch["y"],
        patch["width"], patch["height"], " ".join(map(repr, reading["exposures_s"])), reading.get("name", ""),
        reading.get("session", ""),
    ]  # fmt: skip
    return list(map(spreadsheet_cell, cells))
