"""Alarms: what needs a person's attention, raised and cleared by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import structlog

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
