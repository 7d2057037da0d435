"""The journal: every reading in an SQLite file (WAL), numbered without holes.

Each reading belongs to a stream: "" is the patch that is measured for all, "patch NAME" a patch with a name, "own" what
clients measured for themselves. Beside the readings stands their trend by the minute, so that a month can be drawn.
"""

from __future__ import annotations

import errno
import fcntl
import glob
import hashlib
import math
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Final, Self

from radiometer.daemon.timestamps import iso_time, microseconds, now_us
from radiometer.data import Reading
from radiometer.data.guards import MOST_FILE_BYTES
from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.storage import state_folder, write_bytes_atomic, write_text_atomic
from radiometer.devices.opening import Opened
from radiometer.errors import OutputError, RadiometerError

APPLICATION_ID: Final = 0x52414D4A  # "RAMJ": identifies a radiometer journal to `file` and to us
SCHEMA_VERSION: Final = 3  # 1 had no streams, 2 a trend that mixed places
OWN_STREAM: Final = "own"
_BUSY_TIMEOUT_S: Final = 2.0  # a reader's snapshot or a backup lasts that long; then an alarm
_WAITING: Final = "-waiting-"  # after the journal's name: readings that could not be committed at the end
_NEEDED: Final = {"time", "instrument", "patch", "radiance", "flags", "budget"}  # of a reading that waits
_NO_STOP: Final = (
    "the run before ended without a stop: killed, a power cut, or a journal that could not be written;"
    " the last that it wrote is of "
)
_LAST_WRITTEN: Final = (
    "SELECT max(at) FROM (SELECT max(time_us) AS at FROM readings UNION SELECT max(time_us) FROM events)"
)
_CHECKPOINT_CHANGES: Final = 500  # rows written between two checkpoints: some 4 MB of SQLite's log
_LOG_PART: Final = 0.25  # of the size that the journal may have: SQLite's log next to the file
_ROW_BYTES: Final = 32_768  # that a row takes in the log at most: a page of each table and index
_LOG_BEGINNINGS: Final = (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83")  # sqlite.org/fileformat2.html, 4.1
_RETENTION_CHUNK: Final = 5000  # rows of one transaction: writing is never held up for long
MINUTE_US: Final = 60_000_000  # a minute in µs
_TREND_COLUMNS: Final = (
    "stream TEXT NOT NULL",
    "minute INTEGER NOT NULL",
    "unit TEXT NOT NULL",
    "place TEXT NOT NULL",
    "count INTEGER NOT NULL",
    "total REAL NOT NULL",
    "total_u REAL NOT NULL",
    "low REAL NOT NULL",
    "high REAL NOT NULL",
    "flagged INTEGER NOT NULL",
    "PRIMARY KEY (stream, minute, unit, place)",
)
BOUNDS: Final = {"saturated": "at least", "below_noise": "at most"}  # what a value with such a flag is
_BOUND_OF: Final = " ".join(
    f"WHEN json_extract({{0}}, '$.flags') LIKE '%\"{flag}\"%' THEN ' {bound}'" for flag, bound in BOUNDS.items()
)
# Readings of other places, and values and bounds, share neither mean nor line.
PLACE_OF: Final = f"json_extract({{0}}, '$.instrument', '$.patch') || CASE {_BOUND_OF} ELSE '' END"
_TREND: Final = f"CREATE TABLE trend ({', '.join(_TREND_COLUMNS)}) WITHOUT ROWID;"
_STREAMS: Final = """
CREATE INDEX readings_by_stream ON readings (stream, sequence);
CREATE TABLE patches (name TEXT PRIMARY KEY, json TEXT NOT NULL) WITHOUT ROWID;
"""
_FILL_TREND: Final = f"""
INSERT INTO trend SELECT stream, time_us / 60000000 AS minute, json_extract(json, '$.radiance.unit') AS unit,
    {PLACE_OF.format("json")} AS place, count(*), sum(radiance), sum(coalesce(json_extract(json, '$.radiance.u'), 0)),
    min(radiance), max(radiance), sum(flags <> '')
    FROM readings WHERE radiance IS NOT NULL AND stream <> '{OWN_STREAM}' GROUP BY stream, minute, unit, place;
PRAGMA user_version = {SCHEMA_VERSION};
"""
_UPGRADES: Final = {
    1: f"ALTER TABLE readings ADD COLUMN stream TEXT NOT NULL DEFAULT ''; {_STREAMS} {_TREND} {_FILL_TREND}",
    2: f"DROP TABLE trend; {_TREND} {_FILL_TREND}",
}
_JUMP: Final = (
    "clock_jump:"  # start of a counter's name; the number of the reading after which the clock was set follows
)
_LONGEST_PAUSE_US: Final = 86_400_000_000  # a daemon that was off for longer may as well have a wrong clock
_TREND_UPDATES: Final = (
    "count = count + 1",
    "total = total + :value",
    "total_u = total_u + :u",
    "low = min(low, :value)",
    "high = max(high, :value)",
    "flagged = flagged + :flagged",
)
_ADD_TO_TREND: Final = f"""
INSERT INTO trend VALUES (:stream, :minute, :unit, {PLACE_OF.format(":json")}, 1, :value, :u, :value, :value, :flagged)
ON CONFLICT DO UPDATE SET {", ".join(_TREND_UPDATES)}
"""
_SCHEMA: Final = f"""
PRAGMA application_id = {APPLICATION_ID};
CREATE TABLE readings (
    sequence INTEGER PRIMARY KEY,
    time_us INTEGER NOT NULL,
    radiance REAL,
    flags TEXT NOT NULL,
    json TEXT NOT NULL,
    budget TEXT NOT NULL,
    stream TEXT NOT NULL DEFAULT ''
);
CREATE INDEX readings_by_time ON readings (time_us);
CREATE TABLE events (id INTEGER PRIMARY KEY, time_us INTEGER NOT NULL, kind TEXT NOT NULL, message TEXT NOT NULL);
CREATE INDEX events_by_time ON events (time_us);
CREATE TABLE counters (name TEXT PRIMARY KEY, value INTEGER NOT NULL);
INSERT INTO counters VALUES ('last_sequence', 0);
{_STREAMS}
{_TREND}
PRAGMA user_version = {SCHEMA_VERSION};
"""


def refuse_foreign_objects(connection: sqlite3.Connection, path: Path, error: type[RadiometerError]) -> None:
    """Refuse a journal that holds a view, a trigger or a virtual table: a query of it has no bound."""
    foreign = connection.execute(
        "SELECT type, name FROM sqlite_master WHERE type NOT IN ('table', 'index') OR sql LIKE 'CREATE VIRTUAL%'"
    ).fetchone()
    if foreign is not None:
        raise error(
            f"{path}: holds the {foreign[0]} {foreign[1][:40]!r}, which no journal has: another program changed it;"
            " use a copy from before"
        )


def _jumps(connection: sqlite3.Connection) -> list[tuple[int, int]]:
    """Return after which numbers the clock was set forward, and by which time in µs, in the order of the numbers."""
    rows = connection.execute("SELECT name, value FROM counters WHERE name GLOB ?", (f"{_JUMP}*",)).fetchall()
    return sorted((int(name.removeprefix(_JUMP)), by_us) for name, by_us in rows)


def _first_young(connection: sqlite3.Connection, before_us: int) -> tuple[int, int]:
    """Return the number of the first reading that is not older than a time, and a time before which all are older.

    What was measured before the clock was set counts by the clock as it was then.
    """
    jumps, begin = _jumps(connection), 0
    (last,) = connection.execute("SELECT value FROM counters WHERE name = 'last_sequence'").fetchone()
    limits = [(after, before_us - sum(by_us for _, by_us in jumps[n:])) for n, (after, _) in enumerate(jumps)]
    limits.append((last, before_us))
    for n, (end, limit_us) in enumerate(limits):
        young = connection.execute(
            "SELECT sequence FROM readings WHERE sequence > ? AND sequence <= ? AND +time_us >= ?"
            " ORDER BY sequence LIMIT 1",
            (begin, end, limit_us),
        ).fetchone()
        if young is not None:
            return young[0], min(limit for _, limit in limits[n:])
        begin = end
    return last, before_us


class JournalError(OutputError):
    """The journal cannot be written just now: disk full, file locked, folder gone. Trying again may work."""


class JournalSizeError(JournalError):
    """The journal has the size that it may have: until old readings are deleted, no other can be written."""


class Journal(Opened):
    """Writes readings and events. Use it from one thread at a time; readers have separate connections.

    Args:
        path: The SQLite file; it and its folder are made where missing.
        max_bytes: Size that the file and SQLite's log next to it may not outgrow; None for no limit. Appending then
            raises JournalSizeError.
    """

    def __init__(self, path: Path, *, max_bytes: int | None = None) -> None:
        self.path = path
        self._max_bytes = max_bytes
        self._connection: sqlite3.Connection | None = None
        self._file = path  # where symbolic links lead to, once it is open
        self._lock_file: IO[str] | None = None
        self._descriptor: int | None = None
        self._wal: os.stat_result | None = None  # SQLite's log next to it, as the last transaction left it
        self._database: _Mark | None = None  # of the file itself, as the last checkpoint left it
        self._checkpointed = 0  # rows that the connection had written then
        self._given_up: tuple[_Mark | None, ...] = ()  # of the files that could not be written anew
        self._last_sequence = 0

    def open(self) -> None:
        """Open the journal, making it where missing.

        Raises:
            JournalError: If the file is locked or the disk full: trying again may work.
            OutputError: If the file is no journal, a damaged one, in use by another daemon, or may not be written.
        """
        if self._connection is not None:
            return
        if self._file.exists() and not self._file.is_file():
            raise OutputError(f"{self.path} is no regular file; name another with --journal")
        self._take_locks()
        try:
            connection = self._connect()
            try:
                self._prepare(connection)
            except BaseException:
                connection.close()
                raise
        except sqlite3.Error as error:
            self._release_locks()
            raise self._explain(error) from error
        except OutputError:
            self._release_locks()
            raise
        self._use(connection)

    def _connect(self) -> sqlite3.Connection:
        return sqlite3.connect(self._file, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False)

    def _use(self, connection: sqlite3.Connection) -> None:
        """Write through this connection from now on."""
        self._connection, self._checkpointed, self._given_up = connection, connection.total_changes, ()
        self._wal, self._database = self._wal_now(), self._database_now()

    def close(self) -> None:
        """Close the journal; closing twice does nothing."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        self._release_locks()

    def append(self, readings: Sequence[Reading]) -> list[Reading]:
        """Commit readings in one transaction and return them with their sequence numbers.

        All of them are on disk when this returns, none of them if it raises.

        Raises:
            JournalError: If they cannot be committed now.
        """
        rows = [_Row.of(reading) for reading in readings]
        with self._transaction() as connection:
            last = self._insert(connection, rows)
        self._note_given(last + len(rows))
        return [replace(reading, sequence=sequence) for sequence, reading in enumerate(readings, start=last + 1)]

    def _insert(self, connection: sqlite3.Connection, rows: Sequence[_Row]) -> int:
        """Number readings and write them; return the last number before them."""
        (last,) = connection.execute("SELECT value FROM counters WHERE name = 'last_sequence'").fetchone()
        if last < self._last_sequence:
            raise JournalError(
                f"the content of the journal {self.path} was replaced: its last number is {last}, though"
                f" {self._last_sequence} was given already; put the newer file back, or name another with --journal"
            )
        connection.executemany(
            "INSERT INTO readings VALUES (?, ?, ?, ?, ?, ?, ?)",
            [row.numbered(sequence) for sequence, row in enumerate(rows, start=last + 1)],
        )
        self._note_camera(connection, last, rows)
        connection.executemany(_ADD_TO_TREND, filter(None, (row.trend() for row in rows)))
        connection.execute("UPDATE counters SET value = ? WHERE name = 'last_sequence'", (last + len(rows),))
        return int(last)

    @staticmethod
    def _note_camera(connection: sqlite3.Connection, last: int, rows: Sequence[_Row]) -> None:
        """Note as an event where the readings of another camera begin: after a restart the history goes on."""
        query = "SELECT json_extract(json, '$.instrument') FROM readings WHERE sequence = ?"
        (before,) = connection.execute(query, (last,)).fetchone() or (None,)
        for sequence, row in enumerate(rows, start=last + 1):
            camera = row.mapping["instrument"]
            if before not in (None, camera):
                message = f"from reading {sequence} on, readings are of the camera {camera}, not of {before}"
                _insert_event(connection, "camera", message)
            before = camera

    def save_waiting(self, readings: Sequence[Reading]) -> Path:
        """Write readings that cannot be committed into a file next to the journal, and return it.

        `take_in_waiting` of a later daemon commits them. Raises OutputError if the file cannot be written; the message
        names another place where they are.
        """
        journal = self.path.resolve()
        place = journal.with_name(f"{journal.name}{_WAITING}{now_us()}.jsonl")
        write_text_atomic(place, "".join(f"{_Row.of(reading).waiting_line()}\n" for reading in readings))
        return place

    def take_in_waiting(self) -> list[tuple[str, Path | None]]:
        """Commit the readings of the files that `save_waiting` left, and delete these files.

        A file that was committed is known by its content: one that a kill left behind is deleted only. Lines that are
        no readings, such as one that was cut, stay in their file.

        Returns a line for each file, and the file where it stays.

        Raises:
            JournalError: If they cannot be committed now.
        """
        taken, journal = list[tuple[str, Path | None]](), self.path.resolve()
        for path in sorted(journal.parent.glob(f"{glob.escape(journal.name)}{_WAITING}*.jsonl")):
            content, reason = b"", f"it is no file of at most {MOST_FILE_BYTES / 1e6:g} MB"
            try:
                if path.is_file() and path.stat().st_size <= MOST_FILE_BYTES:
                    content, reason = path.read_bytes(), ""
            except OSError as error:
                reason = str(error)
            if reason:
                taken.append((f"the readings that wait in {path.name} were not taken in: {reason}", path))
                continue
            rows, rest, fault = _waiting_rows(content)
            fresh = bool(rows) and self._take_in(hashlib.sha256(content).hexdigest(), rows)
            if rest:
                if rows:
                    with suppress(OutputError):  # it stays as it is, and is known by its content
                        write_bytes_atomic(path, b"".join(rest), rescue=False)
                text = (
                    f"of {path.name} {len(rows)} readings were taken in; {len(rest)} damaged lines stay there ({fault})"
                    ". Look at what they hold, then move that file away"
                )
                taken.append((text, path))
                continue
            if fresh or not rows:
                taken.append((f"{len(rows)} readings that waited in {path.name} were taken in", None))
            with suppress(OSError):
                path.unlink()
        return taken

    def _take_in(self, digest: str, rows: Sequence[_Row]) -> bool:
        """Commit readings and the mark that their file was taken in, together; return False where it was before."""
        with self._transaction() as connection:
            mark = f"taken in {digest}"
            if connection.execute("SELECT 1 FROM counters WHERE name = ?", (mark,)).fetchone():
                return False
            last = self._insert(connection, rows)
            connection.execute("INSERT INTO counters VALUES (?, ?)", (mark, len(rows)))
        self._note_given(last + len(rows))
        return True

    def note(self, kind: str, message: str) -> None:
        """Commit an event, such as a lost device; a "start" also notes where the run before has no "stop".

        Raises:
            JournalError: If it cannot be committed now.
        """
        with self._transaction() as connection:
            if kind in ("start", "stop"):
                running = connection.execute("SELECT 1 FROM counters WHERE name = 'running' AND value").fetchone()
                if kind == "start" and running:
                    (last_us,) = connection.execute(_LAST_WRITTEN).fetchone()
                    shown = iso_time(last_us)[:19].replace("T", " ") if last_us else "an unknown time"
                    _insert_event(connection, "stop", _NO_STOP + shown)
                connection.execute("INSERT OR REPLACE INTO counters VALUES ('running', ?)", (int(kind == "start"),))
            _insert_event(connection, kind, message)

    def keep_patch(self, name: str, line: str | None) -> None:
        """Commit what is known of a patch with a name, as one line of JSON; None forgets it.

        Raises:
            JournalError: If it cannot be committed now.
        """
        with self._transaction() as connection:
            connection.execute("DELETE FROM patches WHERE name = ?", (name,))
            if line is not None:
                connection.execute("INSERT INTO patches VALUES (?, ?)", (name, line))

    def patches(self) -> dict[str, str]:
        """Return the lines of the patches by name. Raises JournalError if the journal cannot be read now."""
        with self._transaction() as connection:
            return dict(connection.execute("SELECT name, json FROM patches ORDER BY name").fetchall())

    def note_jump(self, by_us: int) -> None:
        """Commit that the clock was set forward by a time in µs since the newest reading; negative for back.

        Raises:
            JournalError: If it cannot be committed now.
        """
        with self._transaction() as connection:
            connection.execute(
                f"INSERT INTO counters SELECT '{_JUMP}' || value, :by FROM counters WHERE name = 'last_sequence'"
                " ON CONFLICT DO UPDATE SET value = value + :by",
                {"by": by_us},
            )

    def note_opening(self, wall_us: int) -> None:
        """Commit that a clock which disagrees with the newest reading by more than a day was set since then.

        So a longer pause does not count in the age of what was measured before it: a wrong clock looks the same.

        Args:
            wall_us: What the clock shows, in µs since 1970 (UTC), before the first reading after the opening.

        Raises:
            JournalError: If it cannot be committed now.
        """
        with self._transaction() as connection:
            newest = connection.execute(
                "SELECT sequence, time_us FROM readings ORDER BY sequence DESC LIMIT 1"
            ).fetchone()
            if newest is None:
                return
            sequence, time_us = newest
            name, before = f"{_JUMP}{sequence}", f"{_JUMP}{sequence - 1}"
            # Older versions kept one sum of all jumps: of those before the newest reading.
            connection.execute("UPDATE OR REPLACE counters SET name = ? WHERE name = 'clock_doubt_us'", (before,))
            connection.execute("DELETE FROM counters WHERE name = ?", (name,))
            if not 0 <= wall_us - time_us <= _LONGEST_PAUSE_US:
                connection.execute("INSERT INTO counters VALUES (?, ?)", (name, wall_us - time_us))

    def drop_older(self, before_us: int) -> int:
        """Delete readings and alarms older than a time, oldest first, and return how many readings went.

        The age of a reading does not count by how much the clock was set after it. The newest reading always stays, and
        so do all after the first that is young enough: a gap in the numbers would be damage. Alarms and minutes of the
        trend have no number, so they stay where any reading of their time could be young enough. Other events stay, as
        remarks of persons and starts.

        Works in small transactions so that writing is never held up for long.

        Args:
            before_us: Time in µs since 1970 (UTC), by the clock as it is set now.

        Raises:
            JournalError: If the file cannot be written now.
        """
        dropped = 0
        while True:
            with self._transaction() as connection:
                kept, all_before_us = _first_young(connection, before_us)
                count = connection.execute(
                    "DELETE FROM readings WHERE sequence IN (SELECT sequence FROM readings WHERE sequence < ?"
                    " ORDER BY sequence LIMIT ?)",
                    (kept, _RETENTION_CHUNK),
                ).rowcount
                connection.execute(
                    "DELETE FROM events WHERE time_us < ? AND kind IN ('alarm', 'cleared')", (all_before_us,)
                )
                connection.execute("DELETE FROM trend WHERE minute < ?", (all_before_us // MINUTE_US,))
                if count < _RETENTION_CHUNK:
                    connection.executemany(
                        "DELETE FROM counters WHERE name = ?",
                        [(f"{_JUMP}{after}",) for after, _ in _jumps(connection) if after < kept],
                    )
            dropped += count
            if count < _RETENTION_CHUNK:
                break
        if dropped:
            self._execute(f"PRAGMA incremental_vacuum({dropped})")
        return dropped

    def _prepare(self, connection: sqlite3.Connection) -> None:
        (application_id,) = connection.execute("PRAGMA application_id").fetchone()
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if tables and application_id != APPLICATION_ID:
            raise OutputError(
                f"{self.path} is an SQLite file but not a radiometer journal; name another with --journal"
            )
        refuse_foreign_objects(connection, self.path, OutputError)
        if version > SCHEMA_VERSION:
            raise OutputError(f"{self.path} was written by a newer radiometer (form {version}); update this one")
        if not tables:
            connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")  # a reading shown to a client survives a power cut
        connection.execute("PRAGMA journal_size_limit = 16777216")
        connection.execute("PRAGMA wal_autocheckpoint = 0")  # `_note_left` does it, and knows who wrote to the file
        connection.execute("PRAGMA cache_size = -512")  # KiB: only the newest pages are ever touched
        if not tables:
            connection.executescript(f"BEGIN EXCLUSIVE; {_SCHEMA} COMMIT;")
        elif version < SCHEMA_VERSION:
            connection.executescript(f"BEGIN EXCLUSIVE; {_UPGRADES[version]} COMMIT;")
        if self._max_bytes is not None:
            (page_size,) = connection.execute("PRAGMA page_size").fetchone()
            pages = int((1 - _LOG_PART) * self._max_bytes) // page_size
            connection.execute(f"PRAGMA max_page_count = {max(1, pages)}")
        self._verify(connection)
        if tables:
            self._require_all_given(connection)

    def _require_all_given(self, connection: sqlite3.Connection) -> None:
        """Refuse a journal that has lost readings: its lock file holds the last number that was given."""
        assert self._lock_file is not None
        self._lock_file.seek(0)
        noted = self._lock_file.read(20).strip()
        given = max(self._last_sequence, int(noted) if noted.isdigit() else 0)
        (last,) = connection.execute("SELECT value FROM counters WHERE name = 'last_sequence'").fetchone()
        if given > last:
            raise OutputError(
                f"{self.path} has lost its readings {last + 1} to {given}: its -wal file was deleted or cut, or an"
                f" older copy was put in its place. Put the files back; or delete {self._file.name}.lock, and these"
                " numbers are given again"
            )

    def _note_given(self, last_sequence: int) -> None:
        assert self._lock_file is not None
        self._last_sequence = last_sequence
        with suppress(OSError):  # a full disk: the readings are in the journal
            self._lock_file.seek(0)
            self._lock_file.truncate()
            self._lock_file.write(f"{last_sequence}\n")
            self._lock_file.flush()

    def _verify(self, connection: sqlite3.Connection) -> None:
        low, high, count = connection.execute(
            "SELECT coalesce(min(sequence), 1), coalesce(max(sequence), 0), count(*) FROM readings"
        ).fetchone()
        (last,) = connection.execute("SELECT value FROM counters WHERE name = 'last_sequence'").fetchone()
        if count != high - low + 1 or (count and high != last):
            raise OutputError(
                f"{self.path} is damaged: sequence {low} to {high} holds {count} readings, counter {last};"
                " keep the file for inspection and name another with --journal"
            )

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Have a write transaction for the block: committed at its end, rolled back on any error."""
        connection = self._connected()
        try:
            connection.execute("BEGIN IMMEDIATE")
            yield connection
            connection.execute("COMMIT")
            self._note_left()
        except sqlite3.Error as error:
            raise self._explain(error) from error
        finally:
            if connection.in_transaction:
                connection.execute("ROLLBACK")

    def _connected(self) -> sqlite3.Connection:
        """Return the connection, opened where it is not, to the file at the journal's path."""
        if self._connection is None:
            self.open()
        self._require_in_place()
        assert self._connection is not None
        return self._connection

    def _require_in_place(self) -> None:
        """Refuse to write where the file was deleted, moved or replaced: its readers would never find what is written.

        A deleted file is written anew, for all that it held can still be read through the open connection.
        """
        assert self._descriptor is not None
        held = os.fstat(self._descriptor)
        try:
            standing = self._file.stat()
        except OSError:
            standing = None
        if standing is not None and os.path.samestat(standing, held):
            self._require_untouched()
            return
        if standing is None and held.st_nlink == 0:
            self._write_anew()
            raise JournalError(f"the journal {self.path} was deleted; it was written anew with all of its readings")
        happened = "deleted, and another file took its place" if held.st_nlink == 0 else "moved or replaced"
        remedy = "move that file away" if held.st_nlink == 0 else "put it back, or restart the daemon for a new one"
        raise JournalError(f"the journal {self.path} was {happened} while the daemon writes it; {remedy}")

    @property
    def _log_path(self) -> Path:
        return self._file.with_name(self._file.name + "-wal")

    def _wal_now(self) -> os.stat_result | None:
        try:
            return self._log_path.stat()
        except OSError:
            return None

    def _database_now(self) -> _Mark | None:
        return None if self._descriptor is None else _Mark.of(os.fstat(self._descriptor))

    def _note_left(self) -> None:
        """Remember how the files look after a transaction, and write SQLite's log into the database now and then.

        Only such a checkpoint writes to the database. Whatever else changes it, also during a transaction, is another
        program, and the next transaction notices it.
        """
        assert self._connection is not None
        changes = self._connection.total_changes
        if self._is_log_cut():
            return
        self._wal = self._wal_now()
        if self._wal is not None and changes - self._checkpointed < self._checkpoint_changes:
            return
        if self._wal is None or self._database == self._database_now():
            with suppress(sqlite3.Error):  # what was committed is in the log
                _, pages, written = self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
                if pages == written:
                    self._checkpointed = changes
            self._wal, self._database = self._wal_now(), self._database_now()

    @property
    def _checkpoint_changes(self) -> int:
        """Return how many rows SQLite's log may hold, which counts as part of the journal's size."""
        if self._max_bytes is None:
            return _CHECKPOINT_CHANGES
        return max(1, min(_CHECKPOINT_CHANGES, int(_LOG_PART * self._max_bytes) // _ROW_BYTES))

    def _is_log_cut(self) -> bool:
        """Return whether SQLite's log lacks its beginning: it was cut during a transaction, and written on behind."""
        try:
            with self._log_path.open("rb") as log:
                beginning = log.read(4)
        except OSError:
            return False
        return bool(beginning) and beginning not in _LOG_BEGINNINGS

    def _require_untouched(self) -> None:
        """Refuse to write where another program cut, overwrote, deleted or replaced the file or SQLite's log.

        What others may do, such as a checkpoint, leaves a sound journal behind: writing goes on. Else it is written
        anew, where all that it held can still be read through the open connection.
        """
        left, now = self._wal, self._wal_now()
        if left is not None and (now is None or not os.path.samestat(left, now)):
            self._write_anew()
            raise JournalError(
                f"the log {self._file.name}-wal of the journal {self.path} was deleted or replaced; the journal was"
                " written anew with all of its readings"
            )
        if self._database == self._database_now() and _Mark.of(left) == _Mark.of(now):
            return
        sound = self._sound_connection()
        if sound is None:
            self._write_anew()
            raise JournalError(
                f"another program cut or overwrote the journal {self.path} or its -wal file; the journal was written"
                " anew with all of its readings"
            )
        assert self._connection is not None
        self._connection.close()
        self._use(sound)

    def _sound_connection(self) -> sqlite3.Connection | None:
        """Return a new connection, which trusts nothing that was read before; None where readings are lost.

        It looks twice: at the file together with SQLite's log, and once that is written into the file, at the file. An
        empty file is not opened: SQLite would delete its log, in which readings may be.
        """
        now = self._database_now()
        if now is None or now.size == 0:
            return None
        for is_first in (True, False):
            connection = self._connect()
            try:
                if connection.execute("PRAGMA quick_check(1)").fetchone() == ("ok",) and _has_tables(connection):
                    self._prepare(connection)
                    if not is_first:
                        return connection
                    connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
                    connection.close()
                    continue
            except sqlite3.Error as error:
                if not _shows_damage(error):
                    connection.close()
                    raise self._explain(error) from error
            except OutputError:
                pass
            connection.close()
            break
        return None

    def _write_anew(self) -> None:
        """Copy the whole journal from the open connection to where its file was, and go on with the copy.

        Where the connection cannot read every reading any more, nothing is touched, and that is the error.
        """
        marks = (self._database_now(), _Mark.of(self._wal_now()))
        if marks == self._given_up:
            raise self._lost()
        copy = self._file.with_name(self._file.name + ".restored")
        try:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.unlink(missing_ok=True)
            if not self._is_whole_copy(copy):
                self._given_up = marks
                copy.unlink(missing_ok=True)
                raise self._lost()
            for ending in ("-wal", "-shm"):  # they belong to the file that was there, not to the copy
                self._file.with_name(self._file.name + ending).unlink(missing_ok=True)
            copy.rename(self._file)
        except sqlite3.Error as error:
            raise self._explain(error) from error
        except OSError as error:
            raise JournalError(f"cannot write the journal {self.path} anew: {error.strerror or error}") from error
        self.close()
        self.open()

    def _lost(self) -> JournalError:
        return JournalError(
            f"another program cut, overwrote or deleted the journal {self.path} or its -wal file: not all of its"
            " readings can be read any more. To go on, stop the daemon, move both files away, put a copy from before in"
            " their place if there is one, and start it again"
        )

    def _is_whole_copy(self, copy: Path) -> bool:
        """Copy what the open connection reads, and return whether that is sound and holds every reading."""
        assert self._connection is not None
        target = sqlite3.connect(copy)
        try:
            self._connection.backup(target)
            if target.execute("PRAGMA integrity_check(1)").fetchone() != ("ok",) or not _has_tables(target):
                return False
            self._verify(target)
            self._require_all_given(target)
        except sqlite3.Error as error:
            if not _shows_damage(error):
                raise
            return False
        except OutputError:
            return False
        finally:
            target.close()
        return True

    def _execute(self, statement: str) -> None:
        try:
            self._connected().execute(statement).fetchall()
            self._note_left()
        except sqlite3.Error as error:
            raise self._explain(error) from error

    def _explain(self, error: sqlite3.Error) -> OutputError:
        code = error.sqlite_errorcode & 0xFF if hasattr(error, "sqlite_errorcode") else sqlite3.SQLITE_ERROR
        if code in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
            return OutputError(f"{self.path} is damaged or no journal ({error}); name another with --journal")
        if self._connection is None and code in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY):
            return OutputError(f"cannot write the journal {self.path}: {error}; name a place that can with --journal")
        what = f"cannot write the journal {self.path}: {error}"
        if code == sqlite3.SQLITE_FULL:
            if self._max_bytes is None or free_bytes(self._file.parent) < self._max_bytes:
                return JournalError(f"{what}; free space on the disk, or shorten --keep-days")
            size = f"it has the {self._max_bytes / 1e6:g} MB of --journal-max-mb"
            return JournalSizeError(f"{what}; {size}: raise that, or shorten --keep-days")
        busy = code == sqlite3.SQLITE_BUSY
        return JournalError(
            f"{what}; {'another program holds it locked; close that program' if busy else 'trying again'}"
        )

    def _take_locks(self) -> None:
        """Lock the name of the file, which those of its WAL depend on, and the file itself, whatever it is called.

        The second also finds a hard link. The descriptor stays open as long as the connection: closing it would drop
        the POSIX locks that SQLite holds on the same file (sqlite.org/howtocorrupt.html, 2.2).
        """
        try:
            self._file = self.path.resolve()
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._lock_file = self._file.with_name(self._file.name + ".lock").open("a+", encoding="ascii")
            fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._release_locks()
            raise OutputError(
                f"another daemon writes the journal {self.path}; stop it or name another with --journal"
            ) from error
        except OSError as error:
            self._release_locks()
            kind = JournalError if error.errno in (errno.ENOSPC, errno.EDQUOT) else OutputError
            raise kind(
                f"cannot write the journal {self.path}: {error.strerror or error}; name another place with --journal"
            ) from error

    def _release_locks(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        if self._lock_file is not None:
            self._lock_file.close()
            self._lock_file = None


def _shows_damage(error: sqlite3.Error) -> bool:
    """Return whether SQLite found the content wrong or cut, not the disk full or the file locked."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR)
    damage = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, sqlite3.SQLITE_SCHEMA)
    return code & 0xFF in damage or code == sqlite3.SQLITE_IOERR_SHORT_READ


def _has_tables(connection: sqlite3.Connection) -> bool:
    return bool(connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])


@dataclass(frozen=True, slots=True)
class _Mark:
    """What changes in a file that is written to."""

    size: int  # bytes
    mtime_ns: int

    @classmethod
    def of(cls, state: os.stat_result | None) -> Self | None:
        return None if state is None else cls(state.st_size, state.st_mtime_ns)


def free_bytes(folder: Path) -> int:
    """Return how much this user may still write into a folder; 0 where that is not known."""
    try:
        space = os.statvfs(folder)
    except OSError:
        return 0
    return space.f_bavail * space.f_frsize


def default_journal_path() -> Path:
    """Return the journal's default place: systemd's state folder, else the user's."""
    if folder := os.environ.get("STATE_DIRECTORY"):
        return Path(folder.split(":")[0]) / "journal.sqlite"
    return state_folder() / "journal.sqlite"


def _waiting_rows(content: bytes) -> tuple[list[_Row], list[bytes], str]:
    """Return the readings of a file that waited, its lines that are none, and what is wrong with the last of those."""
    rows, rest, fault = list[_Row](), list[bytes](), ""
    for number, line in enumerate(content.splitlines(keepends=True), start=1):
        try:
            rows.append(_Row.of_waiting(line.decode()))
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            rest.append(line)
            fault = f"line {number}: {error}"
    return rows, rest, fault


def _insert_event(connection: sqlite3.Connection, kind: str, message: str) -> None:
    connection.execute("INSERT INTO events (time_us, kind, message) VALUES (?, ?, ?)", (now_us(), kind, message))


@dataclass(frozen=True, slots=True)
class _Row:
    """A reading as the journal's tables keep it."""

    mapping: dict[str, Any]  # its JSON form
    budget: dict[str, float]  # relative standard uncertainty by contribution

    @classmethod
    def of(cls, reading: Reading) -> _Row:
        budget = {entry.name: entry.u_rel for entry in reading.budget if math.isfinite(entry.u_rel)}
        return cls(reading.to_mapping(), budget)

    @classmethod
    def of_waiting(cls, line: str) -> _Row:
        """Return what `waiting_line` wrote. Raises ValueError, LookupError, TypeError or AttributeError for others."""
        mapping = parsed_json(line)
        if lacking := _NEEDED - mapping.keys():
            raise ValueError(f"no {sorted(lacking)[0]} in a line")
        row = cls(mapping, {str(name): float(u_rel) for name, u_rel in mapping.pop("budget").items()})
        row.numbered(0)
        row.trend()  # both raise where something is no number or no time
        return row

    def waiting_line(self) -> str:
        """Return the JSON form with the budget."""
        return json_text({**self.mapping, "budget": self.budget})

    @property
    def stream(self) -> str:
        if self.mapping.get("session"):
            return OWN_STREAM
        return f"patch {name}" if (name := self.mapping.get("name")) else ""

    @property
    def time_us(self) -> int:
        return microseconds(self.mapping["time"])

    def numbered(self, sequence: int) -> tuple[int, int, float | None, str, str, str, str]:
        """Return the columns of the table of readings."""
        value, flags = self.mapping["radiance"]["value"], " ".join(self.mapping["flags"])
        value = None if value is None else float(value)
        line = json_text({**self.mapping, "sequence": sequence})
        return sequence, self.time_us, value, flags, line, json_text(self.budget), self.stream

    def trend(self) -> dict[str, Any] | None:
        """Return what it adds to the trend of its minute; None for a client's own, and for what is undefined."""
        radiance = self.mapping["radiance"]
        if self.stream == OWN_STREAM or radiance["value"] is None:
            return None
        return {
            "stream": self.stream,
            "minute": self.time_us // MINUTE_US,
            "unit": radiance["unit"],
            "value": float(radiance["value"]),
            "u": float(radiance["u"] or 0.0),
            "flagged": int(bool(self.mapping["flags"])),
            "json": json_text(self.mapping),
        }
