"""Alarms: what needs a person's attention, raised and cleared by name."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import structlog

from radiometer.daemon.patches import MAIN
from radiometer.data.provenance import utc_now

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class AlarmKind:
    """One of the alarms that the daemon knows."""

    name: str  # its name; a word in capitals is to be read as a channel or the name of a patch
    cause: str  # when it goes up
    end: str  # when it goes down


KINDS: Final = (
    AlarmKind("camera", "the camera is lost, late, or fails to measure", "a measurement works, or where the camera was"
              " lost while idle, it answers again"),
    AlarmKind("light box", "the light box is lost or late", "it answers again; all channels are dark then"),
    AlarmKind("light CHANNEL", "a channel is not at the level that was set", "the channel is set anew"),
    AlarmKind("journal", "the journal cannot be written, or was deleted, moved, replaced or overwritten; or lines of a "
              "`-waiting-` file are damaged",
              "it is written again; that file was moved away"),
    AlarmKind("measurement", "the shared patch cannot be measured, as where every pixel is saturated",
              "it was measured, or continuous measurement ended"),
    AlarmKind("measurement PATCH", "a patch with a name cannot be measured", "it was measured, or was deleted"),
    AlarmKind("period", "fewer than two thirds of the measurements due in the last 10 s (5 periods, if longer) began",
              "nine tenths of them began, or another period was set"),
    AlarmKind("reading", "no reading of the shared patch for the longest of 5 periods, 10 s and 3 times its last "
              "duration, in which measuring was not paused for the journal",
              "a reading of it is in the journal, or continuous measurement ended"),
    AlarmKind("reading PATCH", "the same for a patch with a name", "a reading of it came, or it was deleted"),
    AlarmKind("stopped",
              "a patch has limits, and nothing is measured continuously, or at a period longer than 10 s and than 5 "
              "times that at which they were set",
              "it is, at a shorter period, or no patch has limits"),
    AlarmKind("limit PATCH", "two readings in a row are beyond a limit of the patch, or cannot show whether they are "
              "(clipped, below noise, or of another unit)",
              "two in a row are back inside by the hysteresis, or the limits or the patch changed"),
    AlarmKind("calibration", "the calibration could not be read again, and the old one stays in use",
              "it was read again"),
    AlarmKind("mqtt", "the broker is away, refuses, or does not acknowledge what is published; or another daemon "
              "publishes as the same instrument",
              "it is connected and has acknowledged everything; no other one did for 15 s"),
    AlarmKind("descriptors", "the system gives no more file descriptors, so that new clients are not served",
              "a tenth of them is free again"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Alarm:
    """One thing that is wrong now."""

    name: str  # what it concerns, such as "camera" or "journal"
    message: str  # what is wrong and the way out
    since: str  # ISO 8601 time in UTC at which it began
    announced: int = 1  # how often it was announced: once when it began, and whenever it became worse

    def to_mapping(self) -> dict[str, str]:
        """Return {name, message, since}."""
        return {"name": self.name, "message": self.message, "since": self.since}


class Alarms:
    """The alarms that are up.

    Args:
        on_change: Called with kind, name and message whenever one goes up ("alarm"), becomes worse ("changed") or goes
            down ("cleared").
    """

    def __init__(self, on_change: Callable[[str, str, str], None]) -> None:
        self._on_change = on_change
        self._active: dict[str, Alarm] = {}

    @property
    def active(self) -> tuple[Alarm, ...]:
        """Return the alarms that are up, oldest first."""
        return tuple(self._active.values())

    def message_of(self, name: str) -> str:
        """Return the message of an alarm; "" where it is not up."""
        alarm = self._active.get(name)
        return alarm.message if alarm else ""

    def put_up(self, name: str, message: str, *, worse: bool = False) -> None:
        """Put an alarm up; one that is up keeps its time and takes the new message."""
        standing = self._active.get(name)
        if standing is None:
            self._active[name] = Alarm(name, message, utc_now())
        else:
            self._active[name] = replace(standing, message=message, announced=standing.announced + worse)
        if standing is None or worse:
            _log.warning("alarm", name=name, message=message)
            self._on_change("alarm" if standing is None else "changed", name, message)

    def clear(self, name: str, message: str = "back to normal") -> None:
        """Take an alarm down; one that is not up is left alone."""
        if self._active.pop(name, None) is not None:
            _log.warning("alarm cleared", name=name, message=message)
            self._on_change("cleared", name, message)


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
