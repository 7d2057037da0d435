"""Chances, ranks, and normal scores of variances of few frames, for noise and for a sine at random phases.

From special functions alone: scipy.stats takes longer to load than they take to compute.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from scipy.special import chdtrc, digamma, gammaincinv, gammaln, polygamma

from radiometer.typing import Array, Mask

_SINE_KURTOSIS: Final = -1.5  # excess kurtosis of a sine at a random phase
_FEW_FRAMES: Final = 1.6  # by which few frames weaken it: of cube roots, by simulation of 2 to 15 frames


def chi2_beyond(value: float, freedom: int) -> float:
    """Return the chance that χ² of so many degrees of freedom exceeds a value."""
    return float(chdtrc(freedom, max(value, 0.0)))


def chi2_quantile(chance: float, freedom: int) -> float:
    """Return the value below which χ² of so many degrees of freedom stays with a chance."""
    return float(2.0 * gammaincinv(freedom / 2, chance))


def ranks(values: Array) -> Array:
    """Return the rank of each value from 1 on, equal ones sharing the mean of theirs, (n,)."""
    _, level, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[level])


def sine_freedom(frames: Array, share: Array) -> Array:
    """Return how many degrees of freedom the variance of a capture's frames is worth.

    n values of excess kurtosis κ give a variance of relative variance 2/(n − 1) + κ/n; a sine has κ = −1.5, of
    which the cube root of few values feels less. The first frame of three or more is not among them.

    Args:
        share: Share of the variance that a sine at random phases has; broadcasts.
    """
    counted = frames_counted(frames)
    kurtosis = _SINE_KURTOSIS * np.maximum(1.0 - _FEW_FRAMES / counted, 0.2)
    return np.asarray(2.0 / (2.0 / (counted - 1.0) + kurtosis * share**2 / counted))


def frames_counted(frames: Array) -> Array:
    """Return how many frames of a capture count: the first of three or more may differ for another reason."""
    return np.asarray(np.maximum(np.where(frames > 2, frames - 1.0, frames), 2.0))


def followed_scores(seen: Array, expected: Array, accepted: Array | None, dof: Array, mask: Mask) -> Array:
    """Return the normal scores of variance ratios, 0 where they do not count.

    A least-squares fit of a variance inside a score is biased high (by half for two degrees of freedom), so that
    about an accepted variance the score is followed linearly in the logarithm.

    Args:
        accepted: The same of what is accepted already; None for nothing.
    """
    seen = np.where(mask, seen, 1.0)
    if accepted is None:
        return np.where(mask, normal_score(seen / expected, dof), 0.0)
    return np.where(mask, normal_score(seen / accepted, dof) - score_slope(dof) * np.log(expected / accepted), 0.0)


def score_slope(dof: Array) -> Array:
    """Return by how much a score rises with the logarithm of its ratio, about a ratio of 1."""
    mean, spread = _of_cube_root(dof)
    return np.asarray(mean / (3.0 * np.sqrt(spread)))


def deviances(seen: Array, expected: Array, dof: Array, mask: Mask) -> Array:
    """Return −2·ln of the exact likelihood of each variance ratio but for a constant, 0 where it does not count."""
    seen = np.where(mask, seen, 1.0)
    return np.where(mask, dof * (seen / expected + np.log(expected)), 0.0)


def log_bias(dof: Array) -> Array:
    """Return E[ln(s²/σ²)] for a variance estimated with so many degrees of freedom."""
    return np.asarray(digamma(dof / 2.0) - np.log(dof / 2.0))


def normal_score(ratio: Array, dof: Array) -> Array:
    """Return the nearly normal score of χ²/dof, of mean 0 and variance 1 exactly.

    Source: Wilson & Hilferty (1931), the cube root of a chi-square variable is nearly normal.
    """
    mean, spread = _of_cube_root(dof)
    return np.asarray((np.cbrt(np.maximum(ratio, 0.0)) - mean) / np.sqrt(spread))


def _of_cube_root(dof: Array) -> tuple[Array, Array]:
    """Return mean and variance of the cube root of χ²/dof, from E[(χ²)^p] = 2^p·Γ(dof/2 + p)/Γ(dof/2)."""
    freedoms = np.asarray(dof, dtype=np.float64)
    return _of_the_cube_root(freedoms.tobytes(), freedoms.shape)


@lru_cache(maxsize=64)
def _of_the_cube_root(freedoms: bytes, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return the same for freedoms that a fit asks for at each of its points."""
    half = np.frombuffer(freedoms).reshape(shape) / 2.0
    mean, square = (half**-p * np.exp(gammaln(half + p) - gammaln(half)) for p in (1.0 / 3.0, 2.0 / 3.0))
    return np.asarray(mean), np.asarray(square - mean**2)


def log_variance(dof: Array) -> Array:
    """Return Var[ln s²] for a variance estimated with so many degrees of freedom."""
    return np.asarray(polygamma(1, np.maximum(dof, 1.0) / 2.0))
