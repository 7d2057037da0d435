"""The noise of group means in ln H: from residuals, as weights, and the shift that it gives a curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from radiometer.analysis.response.basis import hat_weight
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.typing import Array

_ROUNDS = 6  # of the weights, which follow the fitted noise
_QUANTISATION_DN2 = 1.0 / 12.0  # variance of rounding to whole numbers
# Hat weight from which a row counts in full: 5 % of the range away from black and from saturation.
_FULLY_TRUSTED_HAT = 0.1
# Exposures nearer to each other than this, in ln t, count as repeats of one.
_LEAST_STEP = 0.1
# What the spline itself can be off by in ln H.
_LEAST_U_LOG = 1e-4


@dataclass(frozen=True, slots=True)
class LogNoise:
    """Variance of ln H of one pixel, a/H + b/H² + (c + 1/12)·g'², and of a mean of n pixels.

    A mean of n pixels has 1/n of that, plus (q + d)·g'² that does not average. Here q is the rounding error where the
    noise does not dither it. d is any other common error (misregistration, compression).
    """

    shot: float  # a, the inverse number of electrons at H = 1
    read: float  # b, the read noise at H = 1, squared
    digital: float  # c in DN², noise that arises after the response curve, rounding left out
    common: float  # d in DN²

    def variance(self, log_exposure: Array, slope: Array, pixels: Array) -> Array:
        """Return the variance of ln H of group means.

        Args:
            log_exposure: g at the rows' digital numbers.
            slope: g' in 1/DN there.
            pixels: Pixels behind each row.
        """
        single = self._single(log_exposure, slope)
        return np.asarray(single / pixels + self.common * slope**2 + self._rounding(log_exposure, slope, pixels))

    def to_mapping(self) -> dict[str, float]:
        """Return the parameters as plain values."""
        return {
            "shot_at_unit_exposure": self.shot,
            "read_at_unit_exposure": self.read,
            "digital_dn2": self.digital,
            "common_dn2": self.common,
        }

    def _single(self, log_exposure: Array, slope: Array) -> Array:
        shot, read = np.exp(-log_exposure), np.exp(-2.0 * log_exposure)
        return np.asarray(self.shot * shot + self.read * read + self.digital * slope**2)

    def _rounding(self, log_exposure: Array, slope: Array, pixels: Array) -> Array:
        """Return the variance that rounding adds: independent for each pixel, and common where not dithered.

        The mean of rounded values with Gaussian noise σ (in DN) is off by a wave over the digital numbers whose
        first harmonic has the amplitude exp(−2π²σ²)/π.

        Source: B. Widrow, I. Kollár, Quantization Noise (2008), section 4: the characteristic function of the
        noise at the quantisation frequency.
        """
        before_rounding_dn2 = self._single(log_exposure, slope) / slope**2
        wave = np.exp(-4.0 * np.pi**2 * before_rounding_dn2) / (2.0 * np.pi**2)
        return np.asarray(slope**2 * (_QUANTISATION_DN2 / pixels + np.minimum(wave, _QUANTISATION_DN2)))


def fit_log_noise(residual: Array, leverage: Array, log_exposure: Array, slope: Array, pixels: Array) -> LogNoise:
    """Return the noise parameters behind the residuals of a fit, all at or above 0.

    Args:
        residual: Residuals of the rows in ln H.
        leverage: Part of each row's own noise that the fit took up, 0 to below 1.
        log_exposure: g at the rows.
        slope: g' at the rows in 1/DN.
        pixels: Pixels behind each row.

    Source: Var(r²) = 2σ⁴ for Gaussian residuals, so that 1/σ⁴ weights a regression of r² on its expectation.
    """
    square = residual**2 / np.maximum(1.0 - leverage, 0.05)
    bent = slope**2
    terms = np.column_stack([np.exp(-log_exposure) / pixels, np.exp(-2.0 * log_exposure) / pixels, bent / pixels, bent])
    noise = LogNoise(1e-4, 0.0, 0.0, 0.0)
    for _ in range(_ROUNDS):
        expected = noise.variance(log_exposure, slope, pixels)
        rounding = noise._rounding(log_exposure, slope, pixels)
        # A wild residual (movement, a defect) counts as five standard deviations, not more.
        target = (np.minimum(square, 25.0 * expected) - rounding) / expected
        weighted = terms / expected[:, None]
        scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
        noise = LogNoise(*(float(value) for value in nnls(weighted / scale, target)[0] / scale))
    return noise


ASSUMPTION = "noise arises before the response curve (shot and read noise); only quantisation after it"


def mean_exposure_dn(dn: Array, variance_dn2: Array, log_exposure: Array, limits: ValueLimits) -> Array:
    """Return the digital number that the mean exposure of a group would have.

    Shot noise is symmetric in exposure, not in digital numbers: behind a curved response the mean of M is not the
    M of the mean H. To second order M(H̄) = M̄ + ½ (g''/g' + g')·σ_M², with the quantisation taken out of σ_M².

    Args:
        dn: Mean digital number of each group, any shape.
        log_exposure: A first estimate of g at every digital number.
        limits: Black and saturation level.

    Source: second-order propagation of moments through h = exp g (GUM 5.1.2, note).
    """
    step = np.maximum(1.0, 0.1 * np.minimum(dn - limits.black_dn, limits.saturated_dn - dn))
    grid = np.arange(log_exposure.size)
    below, here, above = (np.interp(dn + s * step, grid, log_exposure) for s in (-1.0, 0.0, 1.0))
    slope = np.maximum((above - below) / (2.0 * step), 1e-12)
    bend = (above - 2.0 * here + below) / step**2
    noise = np.maximum(variance_dn2 - _QUANTISATION_DN2, 0.0)
    shift = 0.5 * (bend / slope + slope) * noise
    # Beyond half a standard deviation the second order no longer describes the noise.
    return np.asarray(dn + np.clip(shift, -0.5 * np.sqrt(noise), 0.5 * np.sqrt(noise)))


def noise_of(samples: ResponseSamples, dn: Array, log_exposure: Array) -> LogNoise:
    """Return the noise behind the residuals of a first curve, every group's ln E at its hat-weighted mean.

    Args:
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
        log_exposure: ln H of every row, shape (rows,).
        weight: Weight of every row, shape (rows,).
    """
    return group_deviation(log_exposure - samples.log_time, samples.group, weight)


def group_deviation(values: Array, group: NDArray[np.intp], weight: Array) -> tuple[Array, Array]:
    """Return how far every row is from the weighted mean of its group, and its share in that mean.

    Args:
        values: Shape (rows,).
        group: Index of every row's group, ascending.
        weight: Weight of every row.
    """
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    total = np.add.reduceat(weight, starts)
    mean = np.add.reduceat(weight * values, starts) / total
    return values - mean[group], weight / total[group]


def row_variance(samples: ResponseSamples, dn: Array, log_exposure: Array, noise: LogNoise) -> Array:
    """Return the variance of ln H of every row, with what the model of noise and curve leaves out.

    Close to black and saturation the clipped side of the noise is missing from the means, which no variance
    describes: rows fade out there. Nowhere is a mean trusted beyond the truth of the spline itself.

    Args:
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
