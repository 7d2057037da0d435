"""Journal of a test, from which it goes on after a crash; a simulated one is lived through again."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any, Final

from radiometer.data.event_journal import Event, EventJournal
from radiometer.data.json_text import json_text, parsed_json
from radiometer.errors import InputError

FORMAT: Final = "radiometer-adaptation/1"
REFUSED: Final = "refused"
CHECK: Final = "check"
DEVICE_FACTS: Final = ("box", "firmware", "screen", "calibrated")  # of a journal's `stage`, for the table and report


class RunJournal(EventJournal):
    """The journal of a test.

    Args:
        path: The file; created where it is not there.
        relive: Resume a simulated run by simulating it again. Events come anew from the first on (or from the last
            refused try on). They must equal those in the file, and are written where the file ends. A simulated world
            that died with its program is whole again then, down to the temperature of its LEDs.
    """

    path: Path

    def __init__(self, path: Path, *, relive: bool = False) -> None:
        super().__init__(path)
        known = self.events
        tried = max((number + 1 for number, event in enumerate(known) if event["kind"] == REFUSED), default=0)
        self._past: deque[Event] = deque(known[tried:] if relive else [])
        self.events = known[:tried] if relive else known

    def write(self, kind: str, time_s: float, *, lasting: bool = True, **facts: Any) -> Event:
        """Append an event and return it; of a run that is lived through again, the one that is in the file.

        Raises:
            OutputError: If the disk refuses it.
            InputError: If the run is lived through again and this event is another one than the file's.
        """
        if not self._past:
            return super().write(kind, time_s, lasting=lasting, **facts)
        before = self._past.popleft()
        self._compare({"sequence": len(self.events), "kind": kind, "time_s": round(time_s, 4), **facts}, before)
        self.events.append(before)
        return before

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
