"""Moments of a normal variable that cannot pass a limit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from simulators.effects.base import Moments
from simulators.effects.context import Signal

_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
_FAR_SIGMAS = 9.0  # farther below the limit nothing of the distribution reaches it (1e-19)


def censored_above(before: Moments, ceiling: float | NDArray[np.floating[Any]]) -> Moments:
    """Return the moments of min(X, ceiling) for normal X with the given moments.

    With z = (c − μ)/σ, Φ and φ the normal distribution and density:
    E = μ·Φ + c·(1 − Φ) − σ·φ and Var = (μ² + σ²)·Φ − σ·(μ + c)·φ + c²·(1 − Φ) − E², written about c for precision.
    Fixed-pattern and common variances shrink by the squared chance Φ² of staying below the limit.

    Source: Tobin (1958), moments of a censored normal variable.

    Args:
        before: Moments of X.
        ceiling: Highest value, same unit.
    """
    sigma = np.sqrt(np.maximum(before.variance, 1e-24))
    offset, variance = np.asarray(before.mean - ceiling), np.asarray(before.variance)
    shape = np.broadcast_shapes(offset.shape, sigma.shape)
    offset, sigma = np.broadcast_to(offset, shape), np.broadcast_to(sigma, shape)
    near = offset > -_FAR_SIGMAS * sigma
    first, left, below = offset.copy(), np.broadcast_to(variance, shape).copy(), np.ones(shape)
    first[near], left[near], below[near] = _censored(offset[near], sigma[near])
    return Moments(ceiling + first, left, before.spatial_variance * below**2, before.common_variance * below**2)


def _censored(offset: Signal, sigma: Signal) -> tuple[Signal, Signal, Signal]:
    """Return mean (about the ceiling) and variance of a censored normal variable, and its chance to stay below."""
    z = -offset / sigma
    below, density = ndtr(z), np.exp(-0.5 * np.square(z)) / _SQRT_2PI
    first = offset * below - sigma * density
    second = (np.square(offset) + np.square(sigma)) * below - sigma * offset * density
    return first, np.maximum(second - np.square(first), 0.0), below


def censored_below(before: Moments, floor: float) -> Moments:
    """Return the moments of max(X, floor) for normal X: the mirror image of `censored_above`."""
    mirrored = censored_above(
        Moments(-before.mean, before.variance, before.spatial_variance, before.common_variance), -floor
    )
    return Moments(-mirrored.mean, mirrored.variance, mirrored.spatial_variance, mirrored.common_variance)
