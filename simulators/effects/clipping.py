"""Moments of a normal variable that cannot pass a limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, Final

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.special import ndtr

from simulators.effects.base import Moments
from simulators.effects.context import Signal
from simulators.effects.tile_moments import TileMoments

_NODES, _WEIGHTS = hermegauss(5)  # of a normal distribution: exact for polynomials up to the ninth degree
_SPREAD: Final = tuple(zip(_NODES.tolist(), (_WEIGHTS / _WEIGHTS.sum()).tolist(), strict=True))
_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
_FAR_SIGMAS = 9.0  # farther below the limit nothing of the distribution reaches it (1e-19)


def censored_above(before: Moments, ceiling: float | NDArray[np.floating[Any]]) -> Moments:
    """Return the moments of min(X, ceiling) for normal X with the given moments.

    With z = (c − μ)/σ, Φ and φ the normal distribution and density:
    E = μ·Φ + c·(1 − Φ) − σ·φ and Var = (μ² + σ²)·Φ − σ·(μ + c)·φ + c²·(1 − Φ) − E², written about c for precision.
    Fixed-pattern and common variances shrink by the squared chance Φ² of staying below the limit.

    Source: Tobin (1958), moments of a censored normal variable.

    Args:
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


def limited(before: Moments, limit: Callable[[Moments], Moments]) -> Moments:
    """Return the moments behind a limit; what lines and neighbours of tiles share shrinks as fixed patterns do."""
    after = limit(before) if not isinstance(before, TileMoments) else _limited_tile(before, limit)
    return after if before.unrounded is None else after.changed(unrounded=limited(before.unrounded, limit))


def _limited_tile(before: TileMoments, limit: Callable[[Moments], Moments]) -> TileMoments:
    one = np.ones((1,) * before.mean.ndim)
    after = limit(Moments(before.mean, before.variance, one, before.common_variance))
    kept = before.passed(after.mean, np.sqrt(after.spatial_variance))
    return kept.changed(variance=after.variance, common_variance=after.common_variance)


def is_reached(before: Moments, limit: float) -> bool:
    """Tell whether a limit from above is felt at all."""
    return bool(np.max(before.mean + _FAR_SIGMAS * np.sqrt(np.maximum(before.variance, 0.0))) > limit)


def unevenly_limited(before: Moments, limit: Callable[[Moments, float], Moments]) -> Moments:
    """Return the moments behind limits that scatter normally from pixel to pixel, what that leaves as fixed pattern.

    Args:
        before: Moments before it.
        limit: Gives the moments behind a limit that is so many standard deviations away from the usual one.
    """
    parts = [(weight, limit(before, node)) for node, weight in _SPREAD]
    mean = sum(weight * part.mean for weight, part in parts)
    left = sum(weight * np.square(part.mean - mean) for weight, part in parts)
    alike = ("comb_step", "comb_kept", "band_frequency", "unrounded")
    names = [entry.name for entry in fields(before) if entry.name not in alike]
    after = before.changed(**{name: sum(weight * getattr(part, name) for weight, part in parts) for name in names})
    after = after.changed(spatial_variance=after.spatial_variance + left)
    if before.unrounded is not None:
        after = after.changed(unrounded=unevenly_limited(before.unrounded, limit))
    return after.changed(limit_variance=after.limit_variance + left) if isinstance(after, TileMoments) else after
