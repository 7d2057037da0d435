"""The display's slow drift, seen in white shown again and again, and taken out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.screen.meter import ScreenReading


@dataclass(frozen=True)
class Drift:
    """Output of the display over time, relative to its mean."""

    times_s: NDArray[np.float64]  # times of the references in s
    factors: NDArray[np.float64]  # white relative to the mean white at these times
    u_rel: float  # relative standard uncertainty of a value between two references

    @classmethod
    def of(cls, whites: Sequence[ScreenReading]) -> Drift:
        """Return the drift that reference readings of white show.

        What is left of each reference about the straight line between its neighbours is the uncertainty of
        interpolating; the readings' own noise is in it.
        """
        times = np.array([w.time_s for w in whites])
        values = np.array([w.radiance for w in whites])
        factors = values / values.mean()
        return cls(times, factors, _leftover(times, factors, whites))

    def at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return the display's output relative to its mean at a time."""
        return np.asarray(np.interp(np.asarray(time_s, dtype=np.float64), self.times_s, self.factors), dtype=np.float64)

    @property
    def range_rel(self) -> float:
        """Return the highest less the lowest output, relative to the mean."""
        return float(np.ptp(self.factors))


def _leftover(times: NDArray[np.float64], factors: NDArray[np.float64], whites: Sequence[ScreenReading]) -> float:
    noise = float(np.mean([w.u_independent / w.radiance for w in whites])) if whites else 0.0
    if len(times) < 3:
        return max(noise, float(np.ptp(factors)) / 2)
    between = [np.interp(times[i], times[[i - 1, i + 1]], factors[[i - 1, i + 1]]) for i in range(1, len(times) - 1)]
    # A point less the mean of two like it scatters by √1.5 of one; a line between two of them by √0.5.
    scatter = float(np.sqrt(np.mean((factors[1:-1] - np.array(between)) ** 2) / 1.5))
    return float(np.hypot(scatter, noise) * np.sqrt(0.5))
