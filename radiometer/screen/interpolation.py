"""Smooth, never falling interpolation of a display's levels, and its inverse."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from radiometer.typing import Array

# Displays follow a power law of about this exponent, so its root is nearly a straight line of the level.
_STRAIGHTENING: Final = 1 / 2.2


def rising(values: ArrayLike, u: ArrayLike) -> Array:
    """Return the nearest sequence that never falls, weighted by 1/u².

    Args:
        values: Values in order of level, shape (n,), any unit.
        u: Their standard uncertainties, same unit; 0 counts as very small.

    Source: pool-adjacent-violators (Ayer et al. 1955), scipy.optimize.isotonic_regression.
    """
    sigma = np.asarray(u, dtype=np.float64)
    floor = max(float(sigma.max(initial=0.0)) * 1e-3, 1e-300)
    fitted = isotonic_regression(np.asarray(values, dtype=np.float64), weights=1.0 / np.maximum(sigma, floor) ** 2)
    return np.asarray(fitted.x, dtype=np.float64)


class LevelTable:
    """Values over levels, interpolated by a monotone cubic in the straightened value above the black.

    Args:
        levels: Ascending levels 0 to 1, shape (n,), n at least 2.
        values: Values that never fall, 0 or more.

    Source: Fritsch and Carlson 1980 (monotone piecewise cubic interpolation), on (value − black)^(1/2.2).
    """

    def __init__(self, levels: ArrayLike, values: ArrayLike) -> None:
        self.levels = np.asarray(levels, dtype=np.float64)
        self.values = np.asarray(values, dtype=np.float64)
        self._black = float(self.values[0])
        self._curve = PchipInterpolator(self.levels, np.maximum(self.values - self._black, 0.0) ** _STRAIGHTENING)

    def at(self, level: ArrayLike) -> Array:
        """Return the value at levels between the lowest and the highest of the table."""
        inside = np.clip(np.asarray(level, dtype=np.float64), self.levels[0], self.levels[-1])
        straight = np.asarray(self._curve(inside), dtype=np.float64)
        return np.asarray(self._black + np.maximum(straight, 0.0) ** (1 / _STRAIGHTENING), dtype=np.float64)

    def level_of(self, value: float) -> float:
        """Return the lowest level that reaches a value between the table's lowest and highest."""
        low, high = float(self.levels[0]), float(self.levels[-1])
        for _ in range(60):  # 2^-60 of the range: below the resolution of a double
            middle = 0.5 * (low + high)
            low, high = (low, middle) if float(self.at(middle)) >= value else (middle, high)
        return high
