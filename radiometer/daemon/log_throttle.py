"""Keeps the log readable whatever clients do: of lines that say the same, a few a minute are written, and a count."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Final

import structlog
from structlog.typing import EventDict, WrappedLogger

_WINDOW_S: Final = 60.0  # with ten lines of a kind a minute a log stays readable
_MOST: Final = 10  # enough to see a pattern; a thousand connections refused a second show nothing more
_KINDS: Final = 256  # different lines that are remembered


class LogThrottle(logging.Filter):
    """Lets ten lines of each kind pass in a minute; the first of the next minute says how many did not.

    It is a processor of structlog and a filter of the standard library's loggers.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._seen: dict[str, tuple[float, int]] = {}

    def __call__(self, logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
        """Pass an event of structlog on. Raises DropEvent where there were too many like it."""
        suppressed = self._take(str(event.get("event")))
        if suppressed is None:
            raise structlog.DropEvent
        return {**event, "suppressed": suppressed} if suppressed else event

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record of the standard library is written."""
        suppressed = self._take(record.getMessage()[:80])
        if suppressed:
            record.msg = f"{record.msg} ({suppressed} more before were not written)"
        return suppressed is not None

    def install(self) -> None:
        """Put it before structlog's other processors, and onto the loggers of the libraries that serve clients."""
        structlog.configure(processors=[self, *structlog.get_config()["processors"]])
        for name in ("asyncio", "aiohttp.server", "paho"):
            logging.getLogger(name).addFilter(self)

    def _take(self, kind: str) -> int | None:
        """Return how many of a kind were suppressed before this one; None where it is too."""
        now = self._clock()
        since, count = self._seen.pop(kind, (now, 0))
        suppressed = 0
        if now - since >= _WINDOW_S:
            since, count, suppressed = now, 0, max(0, count - _MOST)
        self._seen[kind] = since, count + 1
        if len(self._seen) > _KINDS:
            del self._seen[next(iter(self._seen))]
        return suppressed if count < _MOST else None
