"""Light that is modulated in time, in one phase from frame to frame."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PulsedLight:
    """A periodic light of mean 1: 1 + m·sin(2πft), or a square wave of the same mean that is on for its duty."""

    frequency_hz: float
    modulation: float = 1.0  # m, 0 to 1; of a square wave the share of the light that is switched
    duty: float = 0.0  # share of the period that a square wave is on; 0 for a sine

    def mean(self, start_s: float, duration_s: float) -> float:
        """Return the mean light over a window of time, relative to the long mean."""
        first, last = start_s * self.frequency_hz, (start_s + duration_s) * self.frequency_hz
        if self.duty == 0.0:
            turn = 2.0 * math.pi
            return 1.0 + self.modulation * (math.cos(turn * first) - math.cos(turn * last)) / (turn * (last - first))
        lit = (self._lit(last) - self._lit(first)) / (last - first) / self.duty
        return 1.0 + self.modulation * (lit - 1.0)

    def _lit(self, phase: float) -> float:
        """Return the time in periods that a square wave was on since phase 0."""
        whole = math.floor(phase)
        return whole * self.duty + min(phase - whole, self.duty)
