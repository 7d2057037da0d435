"""Simulated time: nothing sleeps, the clock is moved."""

from __future__ import annotations


class SimulatedClock:
    """A steady clock that moves only when asked to.

    Args:
        start_s: First reading in s.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        """Return the simulated time in s."""
        return self._now_s

    def advance(self, duration_s: float) -> None:
        """Move the clock forward. Raises ValueError if the duration is negative: time does not run back."""
        if duration_s < 0:
            raise ValueError(f"cannot advance the clock by {duration_s} s; durations are 0 or more")
        self._now_s += duration_s

    def sleep(self, duration_s: float) -> None:
        """Pass for `time.sleep` where one is asked for; returns at once with the clock moved on."""
        self.advance(max(duration_s, 0.0))
