"""Hands readings and changes of state to whoever listens; a listener that falls behind is cut off."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Event:
    """Something that is reported to listeners."""

    kind: Literal["reading", "patch", "status"]  # "reading", "patch" (a reading of a patch with a name) or "status"
    line: str  # one line of JSON
    sequence: int | None = None  # sequence number of the reading; None where it is none


class Subscription:
    """One listener's queue."""

    def __init__(self, capacity: int, since_s: float) -> None:
        self._queue: asyncio.Queue[Event | None] = asyncio.Queue(capacity)
        self.closed, self.since_s = False, since_s

    @property
    def waiting(self) -> int:
        """Return how many events the listener has not taken."""
        return self._queue.qsize()

    def offer(self, event: Event) -> None:
        """Queue an event; a full queue ends the subscription, for a gap must not pass unnoticed."""
        if self.closed:
            return
        try:
            self._queue.put_nowait(event)
        except asyncio.QueueFull:
            self.end()

    def end(self) -> None:
        """End the subscription: what was queued is thrown away and `next` returns None."""
        self.closed = True
        while not self._queue.empty():
            self._queue.get_nowait()
        self._queue.put_nowait(None)

    async def next(self) -> Event | None:
        """Return the next event; None once the subscription has ended."""
        return await self._queue.get()


class Hub:
    """The listeners.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._subscriptions: set[Subscription] = set()

    def __len__(self) -> int:
        return len(self._subscriptions)

    def subscribe(self, capacity: int = 256) -> Subscription:
        """Return a new subscription that holds at most `capacity` events not yet taken."""
        subscription = Subscription(capacity, self._clock())
        self._subscriptions.add(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """Forget a subscription."""
        self._subscriptions.discard(subscription)

    def end_one(self, youngest_s: float) -> bool:
        """End the subscription that is furthest behind, else the oldest, and return whether there was one.

        Args:
            youngest_s: One that is not as old as this in s stays.
        """
        old = [one for one in self._subscriptions if self._clock() - one.since_s >= youngest_s]
        if not old:
            return False
        chosen = max(old, key=lambda one: (one.waiting, -one.since_s))
        chosen.end()
        self._subscriptions.discard(chosen)
        return True

    def publish(self, event: Event) -> None:
        """Queue an event with every listener."""
        for subscription in tuple(self._subscriptions):
            subscription.offer(event)
            if subscription.closed:
                self._subscriptions.discard(subscription)

    def close(self) -> None:
        """End every subscription."""
        for subscription in tuple(self._subscriptions):
            subscription.end()
        self._subscriptions.clear()
