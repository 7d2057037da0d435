"""The noise of group means in ln H, estimated from the residuals of a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from radiometer.typing import Array

_QUANTISATION_DN2 = 1.0 / 12.0


@dataclass(frozen=True, slots=True)
class LogNoise:
    """Variance of ln H of one pixel, a/H + b/H² + (c + 1/12)·g'², and of a mean of n pixels.

    A mean of n pixels has 1/n of that, plus (q + d)·g'² that does not average. Here q is the rounding error where the
    noise does not dither it. d is any other common error (misregistration, compression).

    Attributes:
        shot: a, the inverse number of electrons at H = 1.
        read: b, the read noise at H = 1, squared.
        digital: c in DN², noise that arises after the response curve, rounding left out.
        common: d in DN².
    """

    shot: float
    read: float
    digital: float
    common: float

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


def fit_log_noise(
    residual: Array, leverage: Array, log_exposure: Array, slope: Array, pixels: Array, rounds: int = 6
) -> LogNoise:
    """Return the noise parameters behind the residuals of a fit, all at or above 0.

    Args:
        residual: Residuals of the rows in ln H.
        leverage: Part of each row's own noise that the fit took up, 0 to below 1.
        log_exposure: g at the rows.
        slope: g' at the rows in 1/DN.
        pixels: Pixels behind each row.
        rounds: Repetitions of the weighted fit.

    Source: Var(r²) = 2σ⁴ for Gaussian residuals, so that 1/σ⁴ weights a regression of r² on its expectation.
    """
    square = residual**2 / np.maximum(1.0 - leverage, 0.05)
    bent = slope**2
    terms = np.column_stack([np.exp(-log_exposure) / pixels, np.exp(-2.0 * log_exposure) / pixels, bent / pixels, bent])
    noise = LogNoise(1e-4, 0.0, 0.0, 0.0)
    for _ in range(rounds):
        expected = noise.variance(log_exposure, slope, pixels)
        rounding = noise._rounding(log_exposure, slope, pixels)
        # A wild residual (movement, a defect) counts as five standard deviations, not more.
        wanted = (np.minimum(square, 25.0 * expected) - rounding) / expected
        weighted = terms / expected[:, None]
        scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
        noise = LogNoise(*(float(value) for value in nnls(weighted / scale, wanted)[0] / scale))
    return noise
