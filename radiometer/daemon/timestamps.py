"""Times as ISO 8601 and as µs since 1970, both in UTC."""

from __future__ import annotations

import datetime as dt
import re
import time

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
