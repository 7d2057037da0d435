"""How long to wait for a device that is late: longer where it came late, but came, a short while ago."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

_MARGIN: Final = 1.5  # the next late answer may be later by half
_LONGEST_S: Final = 3.0  # a device that is gone is reported this much later at most
_HALVED_AFTER_S: Final = 60.0  # a machine that was busy is calm again after minutes
ON_TIME: Final = 2  # so many answers in time, one after the other, end the alarm: one of them may be luck


class Patience:
    """Learns from answers that came late after all, and forgets: a busy machine must not make an alarm flap.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._learnt_s, self._learnt_at, self._on_time = clock, 0.0, clock(), 0

    @property
    def extra_s(self) -> float:
        """Return the time in s beyond the usual deadline that is still waited."""
        return float(self._learnt_s * 0.5 ** ((self._clock() - self._learnt_at) / _HALVED_AFTER_S))

    def was_late(self, by_s: float) -> None:
        """Note that an answer came, so many s after it was called late."""
        self._learnt_s = min(_LONGEST_S, max(self.extra_s, self.extra_s + _MARGIN * by_s))
        self._learnt_at, self._on_time = self._clock(), 0

    def was_on_time(self) -> bool:
        """Note that an answer came in time, and return whether enough did to believe that all is well."""
        self._on_time += 1
        return self._on_time >= ON_TIME
