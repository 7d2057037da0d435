"""Standard deviations from medians, which a few outliers do not move."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from radiometer.typing import Array

MAD_TO_SIGMA: Final = 1.4826  # 1/Φ⁻¹(3/4): standard deviation of normal values over their median absolute deviation
MEDIAN_U: Final = 1.2533  # √(π/2): standard error of a median of many normal values over that of their mean
TWENTIETH_TO_SIGMA: Final = 1.645  # −Φ⁻¹(0.05): standard deviations from the mean to a twentieth of normal values


def robust_sigma(values: ArrayLike, centre: float | None = None) -> float:
    """Return the standard deviation of normal values from their median absolute deviation, in the values' unit.

    Args:
        values: Any shape, at least one.
        centre: Where the deviations start; None for the median.

    Source: Hampel 1974, JASA 69, 383.
    """
    found = np.asarray(values)
    return float(MAD_TO_SIGMA * np.median(np.abs(found - (np.median(found) if centre is None else centre))))


def neighbour_sigma(differences: Array) -> float:
    """Return the noise of single values from differences of neighbours, which edges and trends do not move.

    Args:
        differences: Of neighbours, any shape, at least one.
    """
    return robust_sigma(differences, 0.0) / math.sqrt(2.0)
