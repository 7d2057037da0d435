"""Puts the box's numbered events in order and finds those that were lost on the line."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from drivers.light_box.frames import Event

KEPT_BY_BOX: Final = 16  # events that the firmware holds for a host that asks again


@dataclass(slots=True)
class EventInbox:
    """Releases events in the order of their numbers, which wrap at 256."""

    expected: int | None = None  # number of the next event to release; None before the first synchronisation
    lost: int = 0  # events that could not be had any more
    _waiting: dict[int, Event] = field(default_factory=dict)

    def start_after(self, number: int) -> None:
        """Forget everything; the next event is the one after `number`."""
        self.expected = (number + 1) % 256
        self._waiting.clear()

    def put(self, event: Event) -> None:
        """Take an event in; one that was released before is left out."""
        if self.expected is not None and (event.number - self.expected) % 256 < 128:
            self._waiting[event.number] = event

    def missing(self, latest: int) -> list[int]:
        """Return the numbers up to `latest` that have not come, oldest first; gives up what the box has dropped."""
        if self.expected is None:
            return []
        ahead = (latest - self.expected + 1) % 256
        if ahead >= 128:  # `latest` is before what was released: an old answer
            return []
        numbers = [(self.expected + step) % 256 for step in range(ahead)]
        for number in numbers[: max(ahead - KEPT_BY_BOX, 0)]:
            if number not in self._waiting:
                self.skip(number)
        return [number for number in numbers if number not in self._waiting]

    def skip(self, number: int) -> None:
        """Give up an event that the box no longer keeps."""
        self._waiting.setdefault(number, Event(number, "--", "-", 0.0))
        self.lost += 1

    def release(self) -> list[Event]:
        """Return the events that have come without a gap, in order."""
        released = []
        while self.expected is not None and self.expected in self._waiting:
            event = self._waiting.pop(self.expected)
            self.expected = (self.expected + 1) % 256
            if event.kind != "--":
                released.append(event)
        return released
