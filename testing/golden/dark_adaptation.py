"""Dark-adaptation curve of published form and parameters.

Source: J. Kelly, R package `Dark`, function P7c and the parameters of its examples (`TestData`): threshold =
θ1 + θ2·exp(−t/θ3) + θ4·(t − θ5)·H(t, θ5) + θ6·(t − θ7)·H(t, θ7), H the step (there a logistic of 10 per min).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DARK_THETA = (-1.0, 1.0, 1.0, -0.24, 6.0, 0.2, 13.0)


def dark_p7(time_min: NDArray[np.float64], theta: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the thresholds in log10 units."""
    one, two, three, four, five, six, seven = theta
    cones = one + two * np.exp(-time_min / three)
    return cones + four * np.maximum(time_min - five, 0.0) + six * np.maximum(time_min - seven, 0.0)
