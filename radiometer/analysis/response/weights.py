"""How far every row of a response fit is to be trusted: its variance in ln H, from the stack's own residuals."""

from __future__ import annotations

import numpy as np

from radiometer.analysis.response.basis import hat_weight
from radiometer.analysis.response.noise import LogNoise, fit_log_noise
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.typing import Array

# Hat weight from which a row counts in full: 5 % of the range away from black and from saturation.
_FULLY_TRUSTED_HAT = 0.1
# Exposures nearer to each other than this, in ln t, count as repeats of one.
_LEAST_STEP = 0.1
# What the spline itself can be off by in ln H.
_LEAST_U_LOG = 1e-4


def noise_of(samples: ResponseSamples, dn: Array, log_exposure: Array) -> LogNoise:
    """Return the noise behind the residuals of a first curve, every group's ln E at its hat-weighted mean.

    Args:
        samples: The rows.
        dn: Their digital numbers (of the mean exposure), shape (rows,).
        log_exposure: The first curve, g at every digital number.
    """
    weight = (hat_weight(dn, samples.limits) ** 2 + 1e-6) * samples.pixels
    residual, own = group_residual(samples, value_at(log_exposure, dn), weight)
    return fit_log_noise(
        residual,
        np.clip(own, 0.0, 0.9),
        value_at(log_exposure, dn),
        slope_at(log_exposure, dn, samples),
        samples.pixels,
    )


def group_residual(samples: ResponseSamples, log_exposure: Array, weight: Array) -> tuple[Array, Array]:
    """Return ln H − ln t − ln E of every row, and the row's share in its group's ln E.

    Args:
        samples: The rows.
        log_exposure: ln H of every row, shape (rows,).
        weight: Weight of every row, shape (rows,).
    """
    starts = np.flatnonzero(np.diff(samples.group, prepend=-1))
    total = np.add.reduceat(weight, starts)
    log_radiance = log_exposure - samples.log_time
    mean = np.add.reduceat(weight * log_radiance, starts) / total
    return log_radiance - mean[samples.group], weight / total[samples.group]


def row_variance(samples: ResponseSamples, dn: Array, log_exposure: Array, noise: LogNoise) -> Array:
    """Return the variance of ln H of every row, with what the model of noise and curve leaves out.

    Close to black and saturation the clipped side of the noise is missing from the means, which no variance
    describes: rows fade out there. Nowhere is a mean trusted beyond the truth of the spline itself.

    Args:
        samples: The rows.
        dn: Their digital numbers (of the mean exposure), shape (rows,).
        log_exposure: g at every digital number.
        noise: Noise of the stack.
    """
    expected = noise.variance(value_at(log_exposure, dn), slope_at(log_exposure, dn, samples), samples.pixels)
    fade = np.clip(hat_weight(dn, samples.limits) / _FULLY_TRUSTED_HAT, 1e-3, 1.0) ** 2
    return np.asarray((expected + _LEAST_U_LOG**2) / fade)


def slope_at(log_exposure: Array, dn: Array, samples: ResponseSamples) -> Array:
    """Return g' in 1/DN at digital numbers, over half an exposure step to either side.

    A wave of one step's period, which the data cannot see, drops out: were it in the slope, and so in the weights, it
    would give weight to what agrees with it and feed itself.

    Args:
        log_exposure: g at every digital number.
        dn: Digital numbers, whole or not, any shape.
        samples: The rows, for their limits and times.
    """
    limits = samples.limits
    ends = value_at(log_exposure, np.array([limits.black_dn, limits.saturated_dn], dtype=np.float64))
    step = max(float(np.median(np.diff(np.unique(samples.frame_log_time)))), _LEAST_STEP)
    here = value_at(log_exposure, dn)
    low, high = np.maximum(here - 0.5 * step, ends[0]), np.minimum(here + 0.5 * step, ends[1])
    rise = dn_at(log_exposure, high) - dn_at(log_exposure, low)
    return np.asarray(np.maximum((high - low) / np.maximum(rise, 1e-9), 1e-9))


def value_at(log_exposure: Array, dn: Array) -> Array:
    """Return the values at digital numbers, whole or not, of what is given at every digital number."""
    return np.asarray(np.interp(dn, np.arange(log_exposure.size), log_exposure))


def dn_at(log_exposure: Array, log_h: Array) -> Array:
    """Return the digital numbers that exposures give through a curve.

    Less light than the curve knows gives black, the highest number of those with the least exposure: a film shows its
    fog there, not 0.

    Args:
        log_exposure: g at every digital number, rising.
        log_h: ln H, any shape.
    """
    black = int(np.flatnonzero(log_exposure <= log_exposure[0])[-1])
    return np.asarray(np.interp(log_h, log_exposure[black:], np.arange(black, log_exposure.size)))
