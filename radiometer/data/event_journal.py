"""Keeps every event of a long measurement in its file before the next one happens: a crash loses none."""

from __future__ import annotations

import contextlib
import datetime as dt
import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, Self

from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import InputError, OutputError, UsageError

START: Final = "start"  # kind of the first event, which holds the format and what was asked for
Event = dict[str, Any]
_BEGINNING: Final = b'{"sequence": 0,'  # of every journal, even where a crash tore its first line


class EventJournal:
    """An append-only file of JSON lines, each flushed when it is written.

    Args:
        path: The file; created where it is not there. None keeps the events in memory alone.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        exists = path is not None and path.exists()
        self._size = path.stat().st_size if path is not None and exists else 0
        self.events: list[Event] = read_events(path) if path is not None and exists else []
        self._of_kind: dict[str, list[Event]] = {}
        self._sorted = 0
        self._stream: IO[bytes] | None = None

    def __enter__(self) -> Self:
        if self.path is None:
            return self
        try:
            self._stream = self.path.open("ab")
            self._take_lock(self.path)
            self._cut_torn_line(self.path)
        except OSError as error:
            self.__exit__()
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error
        return self

    def _take_lock(self, path: Path) -> None:
        """Let no other program append: two measurements in one file destroy both."""
        assert self._stream is not None
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.ENOLCK, errno.EOPNOTSUPP):  # a file system without locks
                return
            raise OSError(errno.EBUSY, "another program runs this test; end it, or name another file") from error
        if path.stat().st_size != self._size:
            raise OSError(errno.EBUSY, "another program has written it meanwhile; run the command again")

    def write(self, kind: str, time_s: float, *, lasting: bool = True, **facts: Any) -> Event:
        """Append an event and return it.

        Args:
            time_s: When, in s.
            lasting: Wait until it is on the disk, so that even a power cut does not lose it; else it is with the
                operating system, which a crash of the program does not touch.

        Raises:
            OutputError: If the disk refuses it.
        """
        event = {"sequence": len(self.events), "kind": kind, "time_s": round(time_s, 4), **facts}
        if self.path is not None:
            self._append(self.path, event, lasting=lasting)
        self.events.append(event)
        return event

    def _append(self, path: Path, event: Event, *, lasting: bool) -> None:
        if self._stream is None:
            raise OutputError(f"{path}: the journal is not open")
        try:
            self._stream.write(json_text(event).encode() + b"\n")
            self._stream.flush()
            if lasting:
                os.fsync(self._stream.fileno())
        except OSError as error:
            raise OutputError(
                f"cannot write {path}: {error.strerror or error}; what was measured before is kept, the same command "
                "goes on from there"
            ) from error

    def of_kind(self, kind: str) -> list[Event]:
        """Return the events of a kind, in order."""
        for event in self.events[self._sorted :]:
            self._of_kind.setdefault(str(event["kind"]), []).append(event)
        self._sorted = len(self.events)
        return list(self._of_kind.get(kind, ()))

    def __exit__(self, *_: object) -> None:
        if self._stream:
            with contextlib.suppress(OSError):  # every event was flushed; what a full disk refused was reported then
                self._stream.close()
            self._stream = None

    def _cut_torn_line(self, path: Path) -> None:
        """Cut off what a crash left of a half-written line, so that the next event begins a new line."""
        if self._stream is None:
            return
        whole = path.read_bytes().rfind(b"\n") + 1
        if whole < path.stat().st_size:
            self._stream.truncate(whole)


def journal_of(output: Path) -> Path:
    """Return the journal of an output, next to it: what was measured for it before it is written."""
    return output.with_name(output.name + ".journal")


@contextmanager
def kept_until_written(
    output: Path | None,
    file_format: str,
    asked: Mapping[str, Any],
    notice: Callable[[str], None],
    wall_s: Callable[[], float] = time.time,
) -> Iterator[EventJournal]:
    """Open the journal of a long measurement for the block that measures and writes its output.

    Where the block ends early, the journal stays, and the same measurement goes on from it. Where it ends well, the
    output holds everything and the journal is removed.

    Args:
        output: File that the block writes; None keeps nothing.
        file_format: Name and version of the journal's form.
        asked: What is measured and with what. A journal of something else is refused.
        notice: Gets a line where a journal goes on, and one where it is kept.
        wall_s: Unix time in s.

    Raises:
        UsageError: If the journal belongs to another measurement.
        OutputError: If it cannot be written.
    """
    with EventJournal(None if output is None else journal_of(output)) as journal:
        facts = {"format": file_format, "asked": parsed_json(json_text(asked))}
        if journal.events:
            _require_same(journal, facts)
            begun = dt.datetime.fromtimestamp(journal.events[0]["unix_s"], dt.UTC)
            notice(
                f"{journal.path} holds a measurement that began {begun:%Y-%m-%d %H:%M} UTC: going on from it; "
                "delete it to begin anew"
            )
        else:
            journal.write(START, 0.0, unix_s=wall_s(), **facts)
        try:
            yield journal
        except BaseException:
            if journal.path is not None and len(journal.events) > 1:
                notice(f"what was measured is kept in {journal.path}: the same command goes on from there")
            elif journal.path is not None:
                journal.path.unlink(missing_ok=True)
            raise
        if journal.path is not None:
            journal.path.unlink(missing_ok=True)


def _require_same(journal: EventJournal, facts: Mapping[str, Any]) -> None:
    begun = journal.events[0]
    way_out = "repeat the command as it was then, or delete the file to begin anew"
    if begun.get("format") != facts["format"] or not isinstance(begun.get("unix_s"), int | float):
        raise UsageError(f"{journal.path}: no journal of this kind of measurement ({facts['format']}); delete it")
    then, now = begun.get("asked"), facts["asked"]
    known = then if isinstance(then, dict) else {}
    for name in {**now, **known}:
        if known.get(name) != now.get(name):
            raise UsageError(
                f"{journal.path}: begun with {name} {known.get(name)!r:.60}, not {now.get(name)!r:.60}; {way_out}"
            )


def is_journal(beginning: bytes) -> bool:
    """Return whether a file with these first bytes is a journal."""
    return beginning.startswith(_BEGINNING)


@bounded_reader(error=InputError)
def read_events(path: Path) -> list[Event]:
    """Return the events of a journal; a last line that was not finished is left out.

    Raises:
        InputError: If it cannot be read, or a line other than the last is damaged or out of order.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if not _BEGINNING.startswith(lines[0][: len(_BEGINNING)]):
        raise InputError(f"{path}: no journal of a measurement; name another file")
    events = list[Event]()
    for number, line in enumerate(lines[:-1]):
        try:
            event = parsed_json(line)
        except ValueError as error:
            raise InputError(f"{path}, line {number + 1}: not a line of a journal ({error})") from error
        if not isinstance(event, dict) or event.get("sequence") != number:
            raise InputError(f"{path}, line {number + 1}: events are missing or out of order")
        events.append(event)
    return events
