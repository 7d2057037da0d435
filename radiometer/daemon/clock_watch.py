"""Notices that the wall clock was set, and keeps a time for deletions that no such jump can move."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final

from radiometer.daemon.timestamps import iso_time, now_us

JUMP_US: Final = 5_000_000  # time services move the clock in steps of less; larger steps are reported
_PERIOD_S: Final = 1.0  # a jump is noted before the next reading of the usual period


def steady_us() -> int:
    """Return a time in µs that cannot be set and that goes on while the machine sleeps (Linux, CLOCK_BOOTTIME)."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) // 1000


@dataclass(frozen=True, slots=True)
class Jump:
    """The wall clock was set."""

    before_us: int  # what it would show had it not been, µs since 1970
    after_us: int  # what it shows

    @property
    def by_us(self) -> int:
        """Return by how many µs it was set forward."""
        return self.after_us - self.before_us

    def __str__(self) -> str:
        way = "forward" if self.by_us > 0 else "back"
        return (
            f"the clock was set {way} by {_written(abs(self.by_us))}, from {iso_time(self.before_us)[:19]}Z to"
            f" {iso_time(self.after_us)[:19]}Z; times of readings jump there, their numbers do not"
        )


class ClockWatch:
    """Compares the wall clock with one that cannot be set.

    Args:
        on_jump: Told of each jump.
        wall_us: Wall clock in µs since 1970.
        steady_us: Steady clock in µs.
    """

    def __init__(
        self,
        on_jump: Callable[[Jump], None],
        wall_us: Callable[[], int] = now_us,
        steady_us: Callable[[], int] = steady_us,
    ) -> None:
        self._on_jump, self._wall_us, self._steady_us = on_jump, wall_us, steady_us
        self._offset_us = wall_us() - steady_us()

    def look(self) -> None:
        """Tell of a jump since the last look; what a time service does little by little is followed."""
        steady, wall = self._steady_us(), self._wall_us()
        expected = steady + self._offset_us
        self._offset_us = wall - steady
        if abs(wall - expected) >= JUMP_US:
            self._on_jump(Jump(expected, wall))

    async def run(self, sleep: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        """Look every second, for ever."""
        while True:
            await sleep(_PERIOD_S)
            self.look()


class RetentionClock:
    """The wall clock as far as the journal knows how it was set: a jump moves it once the journal has noted it.

    Args:
        wall_us: Wall clock in µs since 1970.
        steady_us: Steady clock in µs.
    """

    def __init__(self, wall_us: Callable[[], int] = now_us, steady_us: Callable[[], int] = steady_us) -> None:
        self._wall_us, self._steady_us = wall_us, steady_us
        self._offset_us = wall_us() - steady_us()

    def follow(self, by_us: int) -> None:
        """Go forward by a jump in µs that the journal has noted."""
        self._offset_us += by_us

    def now_us(self) -> int:
        """Return the time in µs since 1970, never later than the wall clock shows."""
        return min(self._wall_us(), self._steady_us() + self._offset_us)


def _written(us: int) -> str:
    seconds = round(us / 1e6)
    for size, unit in ((86_400, "d"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds} s"
