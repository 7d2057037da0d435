"""Moments of a normal variable that is rounded to whole codes, exact also where the noise is below a code."""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
from scipy.special import ndtr, ndtri

from simulators.effects.base import Moments
from simulators.effects.context import Signal

_FINE: Final = 0.6**2  # from this variance on, in DN², rounding moves a mean by less than 3e-4 DN
_REACH_SIGMAS: Final = 9.0  # borders farther away are crossed by 1e-19 of the values
_LEAST_SIGMA_DN: Final = 1e-3  # below it the code is certain
_CODES: Final = 6  # on either side of the nearest: ten sigmas of what counts as coarse
_MOST_KURTOSIS: Final = 100.0  # above it moments say no more
_ONE_CODE: Final = 1e-6  # variance in DN² of values of which all but one in a million show one code
_SPLIT_FROM: Final = 0.3**2  # below, noise and pattern share the variance in proportion: nothing there is normal
_QUANTILES: Final = ndtri((np.arange(15) + 0.5) / 15)  # pixels of a normal pattern, all equally likely

SomeMoments = TypeVar("SomeMoments", bound=Moments)


def rounding_amplitude(before: Moments) -> Signal:
    """Return how far rounding may move the mean, in DN: exp(−2π²σ²)/π for noise and fixed pattern σ together.

    What rows and columns share is a part of both.

    Source: Widrow, Kollár, Liu (1996), "Statistical theory of quantization", first harmonic of the sawtooth.
    """
    fixed, shaken = before.variance_of_lines
    spread = np.maximum(before.variance, 0.0) + np.maximum(before.spatial_variance, 0.0) + fixed + shaken
    return np.asarray(np.exp(-2.0 * np.pi**2 * spread) / np.pi)


def rounded(before: SomeMoments) -> SomeMoments:
    """Return the moments of values in DN after rounding to the nearest whole code.

    With noise of half a code and more that is the mean as it was and 1/12 DN² more variance. Below, mean and variance
    are the sums over the codes of a normal variable cut at half codes. With less than 0.3 DN of noise and fixed
    pattern together, their shares of the variance are not distinguished.

    What the pixels of a row or a column share spreads them over the codes as their independent noise does, and is
    unchanged. The variance of rounding is attributed to noise and pattern of single pixels.

    Args:
        before: Moments in DN, of type `Moments` or derived from it.
    """
    mean, variance, fixed = before.mean, np.maximum(before.variance, 0.0), np.maximum(before.spatial_variance, 0.0)
    lines, shaken = before.variance_of_lines
    shape = np.broadcast_shapes(np.shape(mean), variance.shape, fixed.shape, np.shape(lines), np.shape(shaken))
    coarse = np.broadcast_to(variance + fixed + lines + shaken < _FINE, shape)
    if not coarse.any():
        return before.changed(variance=variance + 1.0 / 12.0, unrounded=before)
    mean, variance, fixed = (np.broadcast_to(values, shape).copy() for values in (mean, variance, fixed))
    shared2 = np.broadcast_to(lines + shaken, shape)[coarse]
    slope = np.ones(shape)
    at, sigma2, pattern2 = mean[coarse], variance[coarse], fixed[coarse]
    mean[coarse], variance[coarse], fixed[coarse], slope[coarse] = _of_coarse(at, sigma2, pattern2, shared2)
    variance[~coarse] += 1.0 / 12.0
    shared = before.passed(mean, slope)  # what pixels share goes by the mean slope
    return shared.changed(variance=variance, spatial_variance=fixed, unrounded=before)


def excess_kurtosis(before: Moments) -> Signal:
    """Return the excess kurtosis of rounded values: of few codes hardly any is normal, and their variance scatters so.

    0 where rounding moves nothing; at most 100, which noise of a sixth of a code has at the middle of one.

    Args:
        before: Moments in DN in front of the rounding; the fixed pattern is left out.
    """
    mean, variance = np.broadcast_arrays(before.mean, np.maximum(before.variance, 0.0))
    found, coarse = np.zeros(mean.shape), variance < _FINE
    if not coarse.any():
        return found
    at, sigma = mean[coarse], np.sqrt(np.maximum(variance[coarse], _LEAST_SIGMA_DN**2))
    codes = np.rint(at)[:, None] + np.arange(-_CODES, _CODES + 1)
    chance = ndtr((codes + 0.5 - at[:, None]) / sigma[:, None]) - ndtr((codes - 0.5 - at[:, None]) / sigma[:, None])
    apart = codes - np.sum(chance * codes, axis=1, keepdims=True)
    square, fourth = (np.sum(chance * apart**power, axis=1) for power in (2, 4))
    differs = square > _ONE_CODE  # else hardly any value differs from the others, and each that does is far off
    found[coarse] = np.where(
        differs, np.minimum(fourth / np.where(differs, square, 1.0) ** 2 - 3.0, _MOST_KURTOSIS), 0.0
    )
    found[coarse] += np.where(differs, 0.0, _MOST_KURTOSIS)
    return found


def _of_coarse(mean: Signal, variance: Signal, pattern2: Signal, shared2: Signal) -> tuple[Signal, ...]:
    """Return mean, variance, variance of the fixed pattern and d(mean)/d(mean before) of rounded values, each (n,).

    Args:
        mean: Mean before.
        variance: Variance of each pixel's own noise.
        pattern2: Variance of each pixel's own pattern.
        shared2: Variance of what lines share, noise and pattern together.
    """
    whole = variance + pattern2 + shared2
    average, together, rise = rounded_normal(mean, whole)
    alone = np.maximum(together - shared2 * rise**2, 0.0)
    own = alone * variance / np.maximum(variance + pattern2, 1e-12)
    asked = (pattern2 + shared2 > 0) & (whole > _SPLIT_FROM)
    if asked.any():
        pixels = mean[asked, None] + np.sqrt((pattern2 + shared2)[asked])[:, None] * _QUANTILES
        within = np.broadcast_to(variance[asked, None], pixels.shape)
        own[asked] = np.minimum(rounded_normal(pixels, within)[1].mean(axis=1), alone[asked])
    return average, own, alone - own, rise


def rounded_normal(mean: Signal, variance: Signal) -> tuple[Signal, Signal, Signal]:
    """Return mean, variance and d(mean)/d(mean before) of a rounded normal variable."""
    sigma = np.sqrt(np.maximum(variance, _LEAST_SIGMA_DN**2))  # a step of a fit may try less than no noise
    nearest = np.rint(mean)
    # E[n] and E[n²] about the nearest code are sums of the chances to lie beyond each border between codes.
    first, second, rise = np.zeros_like(mean), np.zeros_like(mean), np.zeros_like(mean)
    for step in range(1, 1 + int(np.ceil(_REACH_SIGMAS * float(sigma.max())))):
        up, down = (nearest - mean + step - 0.5) / sigma, (mean - nearest + step - 0.5) / sigma
        above, below = ndtr(-up), ndtr(-down)
        first += above - below
        second += (2 * step - 1) * (above + below)
        rise += np.exp(-0.5 * up**2) + np.exp(-0.5 * down**2)
    return nearest + first, second - np.square(first), rise / (sigma * np.sqrt(2.0 * np.pi))
