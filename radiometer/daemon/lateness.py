"""Puts an alarm up where continuous measurement falls behind its period, or where readings stay away."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.patches import MAIN

PERIOD: Final = "period"
READING: Final = "reading"
_WINDOW_S: Final = 10.0  # shorter ones would alarm at every pause of a busy machine
_WINDOW_PERIODS: Final = 5  # one late measurement of five is no alarm
_BEHIND: Final = 2 / 3  # below this share of the measurements due, the alarm goes up
_KEPT: Final = 0.9  # at this share it goes down: a pace near the first bound must not make it flap
_MISSING_PERIODS: Final = 5  # as many as the window of the period
_MISSING_S: Final = 10.0  # shorter pauses come with a busy machine
_MISSING_DURATIONS: Final = 3.0  # a bracket of long exposures may last longer than its period


@dataclass(frozen=True, slots=True)
class _Begun:
    at_s: float
    kind: str


class Lateness:
    """Follows when measurements begin and when readings come.

    Args:
        alarms: Where it reports.
        clock: Steady time in s.

    Attributes:
        missing_s: Shortest time without a reading, in s, that is an alarm.
    """

    def __init__(self, alarms: Alarms, clock: Callable[[], float] = time.monotonic) -> None:
        self._alarms, self._clock = alarms, clock
        self.missing_s = _MISSING_S
        self._every_s: float | None = None
        self._since_s = 0.0
        self._begun: deque[_Begun] = deque()
        self._came: dict[str, float] = {MAIN: 0.0}
        self._usual_s = 0.0

    def follow(self, every_s: float | None) -> None:
        """Expect a reading of every patch each `every_s` from now on; None expects none."""
        now = self._clock()
        if every_s is None or self._every_s is None:
            self._came = dict.fromkeys(self._came, now)
        if every_s is None:
            for name in self._came:
                self._alarms.clear(reading_alarm(name), "continuous measurement was ended")
        self._every_s = every_s
        self._restart(now)
        self._alarms.clear(PERIOD, "the period was set anew")

    def expect(self, name: str) -> None:
        """Expect readings of a patch with a name too."""
        self._came.setdefault(name, self._clock())

    def forget(self, name: str) -> None:
        """Expect no more readings of a patch with a name."""
        self._came.pop(name, None)
        self._alarms.clear(reading_alarm(name), "the patch was deleted")

    def begun(self, kind: str) -> None:
        """Note that a measurement begins: of "shared", "named" or "asked" kind."""
        self._begun.append(_Begun(self._clock(), kind))

    def took(self, seconds: float) -> None:
        """Note how long a measurement of the shared patch took, in s."""
        self._usual_s = seconds

    def came(self, name: str) -> None:
        """Note that a reading of a patch is in the journal; only that ends its alarm."""
        self._came[name] = self._clock()
        self._alarms.clear(reading_alarm(name), "readings come again")

    def look(self, *, able: bool = True, paused: bool = False) -> None:
        """Put alarms up and take them down.

        Args:
            able: Whether measuring is possible: while the camera is lost, no period is missed.
            paused: Whether measuring waits for the journal: its alarm is enough, and readings are due from the end on.
        """
        if self._every_s is None:
            return
        now = self._clock()
        if paused:
            self._came = dict.fromkeys(self._came, now)
        self._look_for_readings(now, self._every_s)
        if paused or not able:
            self._restart(now)
        elif self._every_s > 0:
            self._look_at_period(now, self._every_s)

    def _restart(self, now: float) -> None:
        self._since_s = now
        self._begun.clear()

    def _look_for_readings(self, now: float, every_s: float) -> None:
        longest_s = max(_MISSING_PERIODS * every_s, self.missing_s, _MISSING_DURATIONS * self._usual_s)
        for name, came_s in self._came.items():
            if now - came_s > longest_s:
                pace = f"every {every_s:g} s" if every_s else "as fast as it goes"
                self._alarms.put_up(
                    reading_alarm(name),
                    f"patch {name} has had no reading for {now - came_s:.0f} s, though it is to be measured {pace};"
                    " look at the other alarms, the light and the exposure",
                )

    def _look_at_period(self, now: float, every_s: float) -> None:
        window_s = max(_WINDOW_S, _WINDOW_PERIODS * every_s)
        while self._begun and self._begun[0].at_s < now - window_s:
            self._begun.popleft()
        if now - self._since_s < window_s:
            return
        counts = {kind: sum(one.kind == kind for one in self._begun) for kind in ("shared", "named", "asked")}
        due = window_s / every_s
        if counts["shared"] < _BEHIND * due:
            self._alarms.put_up(
                PERIOD,
                f"the period of {every_s:g} s is not kept. In the last {window_s:.0f} s {counts['shared']} measurements"
                f" of the shared patch began, {counts['named']} of patches with names and {counts['asked']} that"
                " clients asked for. Set a longer period, shorter exposures or fewer patches",
            )
        elif counts["shared"] >= _KEPT * due:
            self._alarms.clear(PERIOD, "the period is kept again")


def reading_alarm(name: str) -> str:
    """Return the name of the alarm that readings of a patch stay away."""
    return READING if name == MAIN else f"{READING} {name}"
