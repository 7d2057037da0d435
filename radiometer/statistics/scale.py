"""Standard deviations: from medians, which few outliers do not move; by restricted likelihood; by the jackknife.

Source of the restricted likelihood (REML): Patterson and Thompson 1971, Biometrika 58, 545.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import scipy.linalg as la
from numpy.typing import ArrayLike, NDArray

from radiometer.typing import Array

MAD_TO_SIGMA: Final = 1.4826  # 1/Φ⁻¹(3/4): standard deviation of normal values over their median absolute deviation
MEDIAN_U: Final = 1.2533  # √(π/2): standard error of a median of many normal values over that of their mean
_REACH_SIGMAS: Final = 4.0  # pixels whose mean lies farther from the median are hot, cold or hit
_LEAST_SIGMA_DN: Final = 0.5  # most means may show one code, and their median deviation is then 0
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


def typical_pixels(means_dn: ArrayLike) -> NDArray[np.bool_]:
    """Return which pixels' means are within four robust standard deviations (at least 0.5 DN each) of their median."""
    reach = _REACH_SIGMAS * max(robust_sigma(means_dn), _LEAST_SIGMA_DN)
    return np.asarray(np.abs(np.asarray(means_dn) - np.median(means_dn)) <= reach)


def neighbour_sigma(differences: Array) -> float:
    """Return the noise of single values from differences of neighbours, which edges and trends do not move.

    Args:
        differences: Of neighbours, any shape, at least one.
    """
    return robust_sigma(differences, 0.0) / math.sqrt(2.0)


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


def spread_beyond_noise(
    variance: float, noise_variance: float, count: float, may_vary: float = 0.0
) -> tuple[float, float]:
    """Return the standard deviation of n values without that of their normal noise, and its standard uncertainty.

    Var(s²) is 4S²σ²/n + 2σ⁴/n.

    Args:
        variance: Of the values.
        noise_variance: Of their noise, which is taken off.
        count: n.
        may_vary: Variance that may be in the values besides, anywhere from 0 to this: k = 2 covers all of it.
    """
    noise, square = max(noise_variance, 0.0) + may_vary, max(variance - noise_variance, 0.0)
    u_square = math.sqrt((4.0 * square + 2.0 * noise) * noise / count)
    value, least = math.sqrt(square), math.sqrt(max(square - may_vary - 2.0 * u_square, 0.0))
    u = min(math.sqrt(u_square), u_square / (2.0 * value) if square > 0.0 else math.inf)
    return value, max(u, (value - least) / 2.0)


def jackknife_u(left: Sequence[ArrayLike], *, few_parts: bool = False) -> Array:
    """Return the standard uncertainty that results with one part of the data left out each show.

    Args:
        left: The result without each part, all of one shape; with fewer than two nothing is known: zero.
        few_parts: Widen u for the small number of parts F, which know the variance only roughly, by (F − 1)/(F − 3).
            Leave it out where the degrees of freedom F − 1 are stated with the result, or where several u are joined.

    Source: grouped jackknife, s² = (F − 1)/F · Σ (θ_f − θ̄)² over F parts; Shao and Tu 1995, section 1.2. The factor
    for few parts: JCGM 101:2008, 6.4.9.
    """
    values = np.array(left, dtype=np.float64)
    count = len(values)
    if count < 2:
        return np.zeros(values.shape[1:] if count else 1)
    variance = (count - 1) * values.var(axis=0)
    return np.asarray(np.sqrt(variance * (count - 1) / max(count - 3, 1) if few_parts else variance))
