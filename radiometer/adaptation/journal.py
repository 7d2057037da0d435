"""Every event of a test in its file before the next one happens: a crash loses no press."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections import deque
from pathlib import Path
from typing import IO, Any, Final, Self

from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import InputError, OutputError

FORMAT: Final = "radiometer-adaptation/1"
REFUSED: Final = "refused"
CHECK: Final = "check"
DEVICE_FACTS: Final = ("box", "firmware", "screen", "calibrated")  # of a journal's `stage`, for the table and report
Event = dict[str, Any]
_BEGINNING: Final = b'{"sequence": 0,'  # of every journal, even where a crash tore its first line


class RunJournal:
    """An append-only file of JSON lines, each flushed when it is written.

    Args:
        path: The file; created where it is not there.
        relive: Resume a simulated run by simulating it again. Events come anew from the first on (or from the last
            refused try on). They must equal those in the file, and are written where the file ends. A simulated world
            that died with its program is whole again then, down to the temperature of its LEDs.
    """

    def __init__(self, path: Path, *, relive: bool = False) -> None:
        self.path = path
        self._size = path.stat().st_size if path.exists() else 0
        known = read_events(path) if path.exists() else []
        tried = max((number + 1 for number, event in enumerate(known) if event["kind"] == REFUSED), default=0)
        self._past: deque[Event] = deque(known[tried:] if relive else [])
        self.events: list[Event] = known[:tried] if relive else known
        self._of_kind: dict[str, list[Event]] = {}
        self._sorted = 0
        self._stream: IO[bytes] | None = None

    def __enter__(self) -> Self:
        try:
            self._stream = self.path.open("ab")
            self._take_lock()
            self._cut_torn_line()
        except OSError as error:
            self.__exit__()
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error
        return self

    def _take_lock(self) -> None:
        """Let no other program append: two runs in one file destroy both."""
        assert self._stream is not None
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.ENOLCK, errno.EOPNOTSUPP):  # a file system without locks
                return
            raise OSError(errno.EBUSY, "another program runs this test; end it, or name another file") from error
        if self.path.stat().st_size != self._size:
            raise OSError(errno.EBUSY, "another program has written it meanwhile; run the command again")

    def write(self, kind: str, time_s: float, *, lasting: bool = True, **facts: Any) -> Event:
        """Append an event and return it.

        Args:
            time_s: When, in s.
            lasting: Wait until it is on the disk, so that even a power cut does not lose it; else it is with the
                operating system, which a crash of the program does not touch.

        Raises:
            OutputError: If the disk refuses it.
            InputError: If the run is lived through again and this event is another one than the file's.
        """
        event = {"sequence": len(self.events), "kind": kind, "time_s": round(time_s, 4), **facts}
        if self._past:
            before = self._past.popleft()
            self._compare(event, before)
            self.events.append(before)
            return before
        if self._stream is None:
            raise OutputError(f"{self.path}: the journal is not open")
        try:
            self._stream.write(json_text(event).encode() + b"\n")
            self._stream.flush()
            if lasting:
                os.fsync(self._stream.fileno())
        except OSError as error:
            raise OutputError(
                f"cannot write {self.path}: {error.strerror or error}; what was measured before is kept, the same "
                "command goes on from there"
            ) from error
        self.events.append(event)
        return event

    def _compare(self, event: Event, before: Event) -> None:
        same = parsed_json(json_text(event)) == before
        if not same and not event["kind"] == before["kind"] == CHECK:  # a calibration has grown older meanwhile
            raise InputError(
                f"{self.path}, line {event['sequence'] + 1}: the simulated run is not the same any more "
                f"({before['kind']} then, {event['kind']} now); options or program have changed, name another journal"
            )

    @property
    def upcoming(self) -> Event | None:
        """Return the event that comes next in a run that is lived through again; None where the new begins."""
        return self._past[0] if self._past else None

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

    def _cut_torn_line(self) -> None:
        """Cut off what a crash left of a half-written line, so that the next event begins a new line."""
        if self._stream is None:
            return
        whole = self.path.read_bytes().rfind(b"\n") + 1
        if whole < self.path.stat().st_size:
            self._stream.truncate(whole)


def is_journal(beginning: bytes) -> bool:
    """Return whether a file with these first bytes is the journal of a run."""
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
        raise InputError(f"{path}: no journal of an adaptation run; name another file")
    events = list[Event]()
    for number, line in enumerate(lines[:-1]):
        try:
            event = parsed_json(line)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}, line {number + 1}: not a line of a journal ({error})") from error
        if not isinstance(event, dict) or event.get("sequence") != number:
            raise InputError(f"{path}, line {number + 1}: events are missing or out of order")
        events.append(event)
    return events
