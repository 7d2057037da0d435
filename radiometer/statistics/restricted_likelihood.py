"""Restricted maximum likelihood (REML): variances and smoothing, with the fitted parameters' freedom taken off.

Source: Patterson and Thompson 1971, Biometrika 58, 545.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as la

from radiometer.typing import Array


def penalised_terms(matrix: Array, right: Array) -> tuple[float, float]:
    """Return (what a penalised fit explains of Σ w·y², ln of the determinant); (0, inf) where it is undetermined.

    Args:
        matrix: Normal matrix with the penalty added, N + λP, shape (k, k).
        right: Right side q of the normal equations, shape (k,).

    Source: Wood 2011, J. R. Stat. Soc. B 73, 3–36, section 2.
    """
    try:
        factor = la.cho_factor(matrix, lower=True)
    except la.LinAlgError:
        return 0.0, float("inf")
    return float(la.cho_solve(factor, right) @ right), 2.0 * float(np.log(np.diag(factor[0])).sum())


def common_deviance(values: Array, size: Array, variance: Array, deviation: Array) -> Array:
    """Return −2 ln of the restricted likelihood that values share one rate, per trial deviation, shape (trials,).

    Matching χ² to its expectation instead would let the noise of faint values pass for a scatter that the bright ones
    contradict.

    Args:
        values: Measured values, shape (n,).
        size: What each value is proportional to (an exposure), shape (n,).
        variance: Variance of each value from its known causes, shape (n,).
        deviation: Standard deviation of each value beyond that in every trial, shape (trials, n).
    """
    total = variance + deviation**2
    weights = size**2 / total
    rates = values / size
    centre = (weights @ rates / weights.sum(1))[:, None]
    return np.asarray(np.log(total).sum(1) + np.log(weights.sum(1)) + (weights * (rates - centre) ** 2).sum(1))
