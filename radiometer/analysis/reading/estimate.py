"""The maximum-likelihood radiance of a patch from all its usable frames, with what the frames say of themselves."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.model import DarkLevel, PatchFrame, SignalModel
from radiometer.statistics.model_choice import AKAIKE, FIVE_SIGMA, is_supported
from radiometer.statistics.scale import common_deviance

# Frames of a steady source through a good calibration agree to this; only more is called flicker.
FLICKER_FLOOR_REL = 1e-3
_GAIN_SIGMAS, _LEAST_GAIN_REL = 5.0, 0.01  # amplifiers keep a gain in dB to a percent
_FLUCTUATION_GRID = np.concatenate([[0.0], np.geomspace(1e-5, 1.0, 101)])


@dataclass(frozen=True, slots=True, eq=False)
class PatchEstimate:
    """Linear signal per exposure (unit of x per s, or per s·sr where exposures carry the lens factor)."""

    rate: float  # estimate
    coefficients: NDArray[np.float64]  # c_i of rate = Σ c_i·(x_i − dark_i)
    expected: NDArray[np.float64]  # expected signal of every frame
    u_noise: float  # standard uncertainty from the noise model
    u_fluctuation: float  # standard uncertainty from what frames differ beyond their noise
    fluctuation_rel: float  # relative standard deviation of that difference
    evidence: float  # twice the gain in log-likelihood that this difference brings
    pixel_rates: NDArray[np.float64]  # the same estimate for every pixel, shape of the patch
    u_pixel: float  # standard uncertainty of one pixel's rate from the noise model
    doubts: tuple[str, ...]  # of the frames' stated gains

    @property
    def degrees_of_freedom(self) -> int:
        """Return frames − 1."""
        return int(self.expected.size - 1)

    @property
    def flickers(self) -> bool:
        """Return whether frames differ more than their noise and the calibration explain."""
        return self.fluctuation_rel >= FLICKER_FLOOR_REL and is_supported(self.evidence, FIVE_SIGMA)


def estimate_patch(
    frames: Sequence[PatchFrame],
    dark: Sequence[DarkLevel],
    exposures: NDArray[np.float64],
    good: NDArray[np.bool_],
    model: SignalModel,
) -> PatchEstimate:
    """Return the maximum-likelihood estimate over frames: weights t²/σ² of the *expected*, never the noisy, signal.

    Weights that follow the noisy sample itself favour the samples that came out low. The expected signal of the
    common estimate has, to first order, no such bias. The reason: the error of the best linear estimate is
    uncorrelated with the differences between frames.

    Args:
        frames: Usable frames, at least one.
        exposures: Exposure time of each in s, times the lens factor in sr where requested.
        good: Pixels to use, shape of the patch.

    Source: iteratively reweighted least squares, Charnes, Frome and Yu 1976, JASA 71, 169.
    """
    means = np.array([f.signal[good].mean() - d.signal for f, d in zip(frames, dark, strict=True)])
    count = int(good.sum())
    rate = float(means.sum() / exposures.sum())
    tau, evidence = 0.0, 0.0
    for _ in range(4):
        expected, single, curve, dark_variance = _variances(rate, frames, dark, exposures, model)
        noise = single / count
        tau, evidence = fluctuation(means, exposures, noise + curve + dark_variance, rate)
        weights = exposures / (noise + curve + dark_variance + (tau * expected) ** 2)
        coefficients = weights / float(weights @ exposures)
        rate = float(coefficients @ means)
    expected, single, curve, dark_variance = _variances(rate, frames, dark, exposures, model)
    pixels = np.tensordot(coefficients, np.stack([f.signal - d.signal for f, d in zip(frames, dark, strict=True)]), 1)
    return PatchEstimate(
        rate,
        coefficients,
        expected,
        u_noise=float(np.sqrt(coefficients**2 @ (single / count))),
        u_fluctuation=float(np.sqrt(coefficients**2 @ (tau * expected) ** 2)),
        fluctuation_rel=tau,
        evidence=evidence,
        pixel_rates=pixels,
        u_pixel=math.sqrt(float(coefficients**2 @ single) + _variance_of_darks(frames, coefficients)),
        doubts=doubted_gains(
            means / exposures,
            (single / count + curve + dark_variance) / exposures**2,
            [f.settings.gain_db for f in frames],
        ),
    )


def _variance_of_darks(frames: Sequence[PatchFrame], coefficients: NDArray[np.float64]) -> float:
    """Return the variance of one pixel's rate by the noise of dark frames, which lights of one exposure share."""
    shared = defaultdict[tuple[float, float, float], float](float)
    for frame, factor in zip(frames, coefficients, strict=True):
        shared[frame.settings.exposure_s, frame.settings.gain_db, frame.dark_variance] += float(factor)
    return sum(factor**2 * variance for (_, _, variance), factor in shared.items())


def _variances(
    rate: float,
    frames: Sequence[PatchFrame],
    dark: Sequence[DarkLevel],
    exposures: NDArray[np.float64],
    model: SignalModel,
) -> tuple[NDArray[np.float64], ...]:
    """Return per frame the expected signal and the variances of one pixel, of the curve and of the dark level."""
    expected = rate * exposures
    each = zip(expected, frames, dark, strict=True)
    single = np.array([float(model.variance(x, f.settings)) + d.variance for x, f, d in each])
    curve = np.array([model.curve_u_rel(x, f.settings) for x, f in zip(expected, frames, strict=True)])
    dark_u = np.array([np.hypot(d.u_independent, d.u_common) for d in dark])
    return expected, single, (curve * expected) ** 2, dark_u**2


def fluctuation(
    means: NDArray[np.float64], exposures: NDArray[np.float64], variance: NDArray[np.float64], rate: float
) -> tuple[float, float]:
    """Return the relative standard deviation between frames beyond their variance, and twice its log-likelihood gain.

    By restricted maximum likelihood. One that chance may have made takes no part.
    """
    if means.size < 2:
        return 0.0, 0.0
    deviance = common_deviance(means, exposures, variance, np.outer(_FLUCTUATION_GRID, rate * exposures))
    best = int(np.argmin(deviance))
    evidence = float(deviance[0] - deviance[best])
    return (float(_FLUCTUATION_GRID[best]), evidence) if is_supported(evidence, AKAIKE) else (0.0, evidence)


def doubted_gains(
    rates: NDArray[np.float64], variance: NDArray[np.float64], gains_db: Sequence[float]
) -> tuple[str, ...]:
    """Return what to say of gains whose frames disagree on the light by more than their noise and scatter.

    Args:
        rates: Signal of each frame over its exposure and its stated gain, shape (frames,).
        variance: Of each from its known causes.
    """
    gains = np.round(gains_db, 6)
    found = {gain: _mean_rate(rates[gains == gain], variance[gains == gain]) for gain in np.unique(gains).tolist()}
    lowest, (reference, u_reference) = next(iter(found.items()))
    doubts = []
    for gain, (rate, u) in found.items():
        apart, limit = rate - reference, max(_GAIN_SIGMAS * math.hypot(u, u_reference), _LEAST_GAIN_REL * reference)
        if min(rate, reference) > 0.0 and abs(apart) > limit:
            real_db = gain - lowest + 20.0 * math.log10(rate / reference)
            doubts.append(
                f"frames at {gain:g} dB show {100 * apart / reference:+.1f} % against those at {lowest:g} dB: the "
                f"light changed between them, or the gain rises by {real_db:.2f} dB and not by {gain - lowest:g}"
            )
    return tuple(doubts)


def _mean_rate(rates: NDArray[np.float64], variance: NDArray[np.float64]) -> tuple[float, float]:
    """Return the mean of rates of one gain and its standard uncertainty by their noise, or by their scatter."""
    scatter = float(np.var(rates, ddof=1)) if rates.size > 1 else 0.0
    return float(rates.mean()), math.sqrt(max(float(variance.mean()), scatter) / rates.size)
