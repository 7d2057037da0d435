"""Pixels that scatter far more than the others of their tile: when one counts, and how likely it is to.

A pixel is restless where all its frames scatter too much, and unsteady where they do so without the highest one. A
cosmic ray raises a pixel in one frame only.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.special import chdtri, ndtr, ndtri

_FALSE: Final = 1e-6  # share of the pixels of normal noise that are restless, too; hardly any is unsteady
_EDGES: Final = np.arange(31) / 3.0
EXPONENTIAL: Final = 0.5 * (_EDGES[1:] + _EDGES[:-1])  # values of an exponential distribution, in units of its mean
EXPONENTIAL_SHARES: Final = np.exp(-_EDGES[:-1]) - np.exp(-_EDGES[1:])  # share of each
_QUANTILES: Final = (np.arange(16) + 0.5) / 16


def unsteady_from(frames: Any) -> Any:
    """Return the temporal variance over that of its tile from which on a pixel is restless.

    Args:
        frames: Number of frames; infinite of one frame, which has no variance.
    """
    freedom = np.asarray(frames, dtype=np.float64) - 1.0
    least = chdtri(np.maximum(freedom, 1.0), _FALSE) / np.maximum(freedom, 1.0)
    return np.where(freedom > 0, least, np.inf)


def share_unsteady(frames: Any, noise: Any, height: Any = 0.0, high: Any = 1.0) -> Any:
    """Return the chance that a pixel is unsteady.

    Args:
        frames: Number of frames, the highest included.
        noise: Variance of its normal noise, over that of its tile.
        height: What it is higher by in some of the frames, over the sigma of the normal noise.
        high: Number of these frames.
    """
    n, k = np.maximum(frames, 3.0), np.maximum(high, 2.0)
    left = (n - 1.0 - (n * _highest(n, 2) - 1.0) / (n - 1.0)) / (n - 2.0)  # of the noise, without the highest
    height = np.maximum(height - _highest(k, 1) / (k - 1.0), 0.0)  # the highest is above the other high ones
    jumps = np.square(height) * (k - 1.0) * (n - k) / (n - 1.0) * (np.asarray(high) > 1)
    return share_restless(np.asarray(frames) - 1.0, left * noise, jumps / left)


def _highest(numbers: Any, power: int) -> Any:
    """Return the mean of a power of the highest of so many normal values."""
    return np.power(ndtri(np.power(_QUANTILES, 1.0 / np.asarray(numbers)[..., None])), power).mean(axis=-1)


def share_restless(frames: Any, noise: Any, jumps: Any = 0.0) -> Any:
    """Return the chance that a pixel is restless.

    Args:
        frames: Number of frames.
        noise: Variance of its normal noise, over that of its tile.
        jumps: Sum of squares of what its expected values differ by from their mean, over the normal noise.

    Source: Sankaran (1959), Biometrika 46, 235: a power of a non-central chi-square is nearly normal.
    """
    freedom = np.maximum(np.asarray(frames, dtype=np.float64) - 1.0, 1.0)
    limit = unsteady_from(frames) * freedom / noise
    power = 1.0 - 2.0 / 3.0 * (freedom + jumps) * (freedom + 3.0 * jumps) / np.square(freedom + 2.0 * jumps)
    p = (freedom + 2.0 * jumps) / np.square(freedom + jumps)
    m = (power - 1.0) * (1.0 - 3.0 * power)
    middle = 1.0 + power * p * (power - 1.0 - 0.5 * (2.0 - power) * m * p)
    sigma = power * np.sqrt(2.0 * p) * (1.0 + 0.5 * m * p)
    return ndtr((middle - np.power(limit / (freedom + jumps), power)) / sigma)
