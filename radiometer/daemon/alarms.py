"""Alarms: what needs a person's attention, raised and cleared by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import structlog

from radiometer.data.provenance import utc_now

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Alarm:
    """One thing that is wrong now.

    Attributes:
        name: What it concerns, such as "camera" or "journal".
        message: What is wrong and the way out.
        since: ISO 8601 time in UTC at which it began.
        announced: How often it was announced: once when it began, and whenever it became worse.
    """

    name: str
    message: str
    since: str
    announced: int = 1

    def to_mapping(self) -> dict[str, str]:
        """Return {name, message, since}."""
        return {"name": self.name, "message": self.message, "since": self.since}


class Alarms:
    """The alarms that are up.

    Args:
        on_change: Called with kind ("alarm" or "cleared"), name and message whenever one goes up or down.
    """

    def __init__(self, on_change: Callable[[str, str, str], None]) -> None:
        self._on_change = on_change
        self._active: dict[str, Alarm] = {}

    @property
    def active(self) -> tuple[Alarm, ...]:
        """Return the alarms that are up, oldest first."""
        return tuple(self._active.values())

    def put_up(self, name: str, message: str, *, worse: bool = False) -> None:
        """Put an alarm up; one that is up keeps its time and takes the new message.

        Args:
            name: What it concerns.
            message: What is wrong and the way out.
            worse: Announce it again although it is up.
        """
        standing = self._active.get(name)
        if standing is None:
            self._active[name] = Alarm(name, message, utc_now())
        else:
            self._active[name] = replace(standing, message=message, announced=standing.announced + worse)
        if standing is None or worse:
            _log.warning("alarm", name=name, message=message)
            self._on_change("alarm", name, message)

    def clear(self, name: str, message: str = "back to normal") -> None:
        """Take an alarm down; one that is not up is left alone."""
        if self._active.pop(name, None) is not None:
            _log.info("alarm cleared", name=name, message=message)
            self._on_change("cleared", name, message)
