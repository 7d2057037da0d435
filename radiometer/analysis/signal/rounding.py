"""Rounding to whole codes: the temporal variance before it, from the variance after it.

Rounding adds 1/12 of a squared code step (Sheppard's correction) as long as the noise before it spreads over several
codes. Below about 0.5 steps of noise the correction breaks down: the variance after rounding then depends on where
between two codes the pixels are. This module inverts that dependence and states how far it can be inverted.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from radiometer.data import Quantity

SHEPPARD: Final = 1.0 / 12.0  # squared code steps
PLAIN_FROM: Final = 0.24  # variance after rounding; below it, EMVA 1288 (6.7) gives an upper limit only
_OF_TWO_CODES: Final = 0.25  # the most that two codes vary by, in squared code steps
# From here on Sheppard's correction errs by less than (1/π² + 4σ²)·exp(−2π²σ²) = 0.003 squared steps.
_SHEPPARD_FROM: Final = 0.40
_SIGMAS: Final = np.concatenate([[1e-3], np.geomspace(0.02, 0.75, 60)])  # noise before rounding, in steps
_PHASES: Final = np.linspace(-0.5, 0.5, 41)  # places between codes, in steps
# Pixel distributions are normal to a few per cent only; so is the predicted variance.
_MODEL_REL: Final = 0.05
_SEEN_SIGMAS: Final = 2.0


def unrounded_variance(
    variance_dn2: float, u_dn2: float, mean_dn: float, spatial_variance_dn2: float, step_dn: int = 1
) -> Quantity:
    """Return the temporal variance in DN² before rounding, with its standard uncertainty.

    Args:
        variance_dn2: Mean temporal variance of the pixels after rounding.
        u_dn2: Its standard uncertainty.
        mean_dn: Mean over pixels and frames; its fraction shows where between two codes the pixels are.
        spatial_variance_dn2: Variance of the pixels' means, which spreads them over the codes.

    Returns:
        Sheppard's correction where it holds. Below, the middle of the noise that may have given the measured
        variance, with a rectangular distribution over its range.

    Source: Widrow, Kollár, Quantization Noise (2008), chapters 4 and 5; EMVA Standard 1288, release 4.0, section 6.7.
    """
    squared = float(step_dn) ** 2
    measured, u = variance_dn2 / squared, u_dn2 / squared
    if measured >= _SHEPPARD_FROM:
        noise = measured - SHEPPARD
        # The harmonic of the place between two codes, which is left: of a sine the root mean square is 1/√2.
        u_place = (1.0 / math.pi**2 + 4.0 * noise) * math.exp(-2.0 * math.pi**2 * noise) / math.sqrt(2.0)
        return Quantity(noise * squared, math.hypot(u, u_place) * squared, "DN^2")
    spread = math.sqrt(max(spatial_variance_dn2, 0.0)) / step_dn
    predicted = _predicted(mean_dn / step_dn, spread)
    tolerance = np.hypot(_SEEN_SIGMAS * u, _MODEL_REL * predicted + 1e-4)
    fits = np.flatnonzero(np.abs(predicted - measured) <= tolerance)
    if fits.size == 0:
        fits = np.array([int(np.argmin(np.abs(predicted - measured)))])
    # The grid is coarse: the truth may be up to its neighbours.
    low = _SIGMAS[max(int(fits[0]) - 1, 0)] ** 2
    high = _SIGMAS[min(int(fits[-1]) + 1, _SIGMAS.size - 1)] ** 2
    return Quantity((low + high) / 2.0 * squared, (high - low) / math.sqrt(12.0) * squared, "DN^2")


def rounding_u_of_mean(variance_dn2: float, step_dn: int = 1) -> float:
    """Return the standard uncertainty in DN that rounding leaves in a mean, which is no less of many pixels and frames.

    Noise before rounding spreads the pixels over the codes, and the mean over these errs by less.

    Args:
        variance_dn2: Variance after rounding in DN², of pixels and frames together.

    Returns:
        That of a place anywhere between two codes. Where a part p of the pixels has the upper of two codes, these vary
        by p·(1 − p), and the noise is unknown. Without any the mean is off by p − ½, with much of it by nothing.
    """
    steps = variance_dn2 / step_dn**2
    of_two = max(_OF_TWO_CODES - steps, 0.0) / 3.0
    return step_dn * math.sqrt(of_two + _error_by_noise(max(steps, _OF_TWO_CODES) - SHEPPARD))


def rounding_u_of_light(dark_variance_dn2: float, shot_dn2: float, step_dn: int = 1) -> float:
    """Return the same of light whose noise is that of dark frames and shot noise; it is elsewhere between two codes.

    Args:
        dark_variance_dn2: Variance of dark frames after rounding in DN², of pixels and frames together.
        shot_dn2: Variance of the light's shot noise in DN².
    """
    steps = dark_variance_dn2 / step_dn**2
    least = 0.0  # noise that may have made that variance: midway between two codes, a quarter needs none
    if steps >= _SHEPPARD_FROM:
        least = steps - SHEPPARD
    elif steps > _OF_TWO_CODES:
        least = float(ndtri((steps - _OF_TWO_CODES) / 4.0)) ** -2  # two further codes, 1.5 steps off
    return step_dn * math.sqrt(_error_by_noise(least + shot_dn2 / step_dn**2))


def _error_by_noise(noise: float) -> float:
    """Return the mean square error of a rounded mean in squared steps, over all places between two codes.

    Source: Widrow, Kollár, Quantization Noise (2008), chapter 4: the harmonics of the error over the place.
    """
    harmonic = np.arange(1, 100)
    squares = np.exp(-4.0 * (np.pi * harmonic) ** 2 * noise) / (2.0 * (np.pi * harmonic) ** 2)
    return float(np.sum(squares))


def _predicted(mean: float, spread: float) -> NDArray[np.float64]:
    """Return the mean temporal variance after rounding for each noise before it, in squared steps."""
    fraction = mean - math.floor(mean + 0.5)
    # Pixels that spread over a whole step are everywhere between the codes; finer than 0.01 steps makes no difference.
    known = [_of_pixels(float(sigma), round(min(spread, 1.0), 2)) for sigma in _SIGMAS]
    return np.array([np.interp(np.interp(fraction, means, _PHASES), _PHASES, variances) for means, variances in known])


@cache
def _of_pixels(sigma: float, spread: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and mean temporal variance after rounding, for each place of the pixels' centre between two codes."""
    normal = np.linspace(-3.0, 3.0, 61)
    weights = np.exp(-(normal**2) / 2.0)
    places = _PHASES[:, np.newaxis] + spread * normal
    centre = np.round(places)
    codes = np.arange(-4, 5)
    within = (places - centre)[..., np.newaxis]
    share = ndtr((codes + 0.5 - within) / sigma) - ndtr((codes - 0.5 - within) / sigma)
    mean = share @ codes
    variance = share @ codes**2 - mean**2
    weights /= weights.sum()
    return (mean + centre) @ weights, variance @ weights
