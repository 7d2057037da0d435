"""Times as ISO 8601 and as µs since 1970 in UTC, and whether the wall clock was set."""

from __future__ import annotations

import asyncio
import datetime as dt
import re
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final

from radiometer.errors import UsageError
from radiometer.moments import moment_of

_UNITS_S = {"s": 1, "m": 60, "min": 60, "h": 3600, "d": 86400, "w": 604800}
_AGO = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|m|h|d|w)")


def now_us() -> int:
    """Return the present time in µs since 1970."""
    return time.time_ns() // 1000


def microseconds(iso: str) -> int:
    """Return an ISO 8601 time in µs since 1970; a time without zone is UTC. Raises ValueError."""
    return (moment_of(iso) - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)) // dt.timedelta(microseconds=1)


def parse_moment(text: str, now: int | None = None) -> int:
    """Return the µs since 1970 of an ISO 8601 time, or of an age such as "90s", "15min", "2h", "7d".

    Args:
        text: The time; without a zone it is UTC.
        now: Present time in µs; the clock's where None.

    Raises:
        UsageError: If it is neither.
    """
    try:
        if age := _AGO.fullmatch(text.strip()):
            return microseconds(iso_time((now_us() if now is None else now) - int(_seconds(age) * 1e6)))
        return microseconds(text.strip())
    except (ValueError, OverflowError) as error:
        raise UsageError(
            f"{text!r} is no time; give ISO 8601 (2026-11-20T12:00:00Z) or an age (90s, 15min, 2h, 7d)"
        ) from error


def _seconds(age: re.Match[str]) -> float:
    return float(age[1]) * _UNITS_S[age[2]]


def iso_time(time_us: int) -> str:
    """Return µs since 1970 as ISO 8601 in UTC with microseconds."""
    moment = dt.datetime(1970, 1, 1, tzinfo=dt.UTC) + dt.timedelta(microseconds=time_us)
    return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")


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
