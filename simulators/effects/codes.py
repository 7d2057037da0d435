"""From values to whole codes, of which some are never used."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from simulators.effects.base import DIGITAL_NUMBER, Effect, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

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


@dataclass(frozen=True)
class Quantisation(Effect):
    """Scales native DN to those of the output's bit depth and rounds to the nearest code.

    `mean` is the unrounded value and the added variance 1/12 DN². With normal noise σ (in codes) before it the true
    mean is at most exp(−2π²σ²)/π codes off (0.002 at σ = 0.5); `moments` is exact with less noise than that too. The
    converter is taken to deliver the output's bits directly (16-bit output is finer than 12-bit output, not shifted).

    Source: EMVA Standard 1288, release 4.0, equation (12).
    """

    name = "quantisation"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * context.output_scale

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        codes: Signal = np.rint(signal * context.output_scale)
        return codes

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 / 12.0

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        return rounded(before.passed(self.mean(before.mean, context), self.slope(before.mean, context)))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.output_scale


_SAMPLES: Final = 4096  # of one step, for its Fourier series
_HARMONICS: Final = 8
_NARROW: Final = 0.2  # of a step, below which noise resolves more harmonics
_PER_CODE: Final = 2  # harmonics per code where single codes are left out
_STEPS: Final = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 32.0, 64.0, 128.0, 256.0)


@cache
def _series(step: int, kept: int) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the Fourier coefficients of what is cut off within a step, and of its square, the constant first."""
    x = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * step
    cut = x - np.minimum(np.floor(x), kept - 1.0) if kept > 1 else x
    count = _HARMONICS if kept == 1 else max(_HARMONICS, _PER_CODE * step)
    shift = np.exp(-1j * np.pi * np.arange(count + 1) / _SAMPLES)  # samples lie in the middle of their cells
    first, second = (np.fft.fft(values)[: count + 1] / _SAMPLES * shift for values in (cut, cut**2))
    return first, second


def _expected(u: Signal, variance: Signal, step: int, kept: int) -> tuple[Signal, Signal, Signal]:
    """Return the mean of what is cut off from a normal variable, of its square, and the derivative of the former."""
    cut, square, slope = _by_series(u, variance, step, kept)
    narrow = np.broadcast_to(variance < (_NARROW * step) ** 2, u.shape)
    if kept == 1 and narrow.any():  # more harmonics than the series has; few borders between codes instead
        at, spread2 = u[narrow], np.broadcast_to(variance, u.shape)[narrow]
        code, left2, rise = rounded_normal(at / step - 0.5, spread2 / step**2)
        cut[narrow], slope[narrow] = at - step * code, 1.0 - rise
        square[narrow] = step**2 * left2 + cut[narrow] ** 2 + spread2 * (1.0 - 2.0 * rise)
    return cut, square, slope


def _by_series(u: Signal, variance: Signal, step: int, kept: int) -> tuple[Signal, Signal, Signal]:
    first, second = _series(step, kept)
    cut, square, slope = (np.full_like(u, value) for value in (first[0].real, second[0].real, 0.0))
    turn, turned = np.exp(2j * np.pi / step * u), np.ones_like(u, dtype=np.complex128)
    for h in range(1, first.size):
        rate = 2.0 * np.pi * h / step
        turned = turned * turn
        wave = 2.0 * np.exp(-0.5 * rate**2 * variance) * turned
        cut += (first[h] * wave).real
        square += (second[h] * wave).real
        slope += (1j * rate * first[h] * wave).real
    return cut, square, slope


@dataclass(frozen=True)
class MissingCodes(CatalogueEffect):
    """Keeps only the first k of every q codes: y' = q·⌊z/q⌋ + min(z mod q, k − 1), z = y + a; for k = 1 each q-th.

    A coarser converter cuts (a = 0) or rounds to the nearest of its codes (a = ⌊q/2⌋), which lifts the mean by as much.
    Moments are those of a quantised normal variable, exact also where the noise is below the step.

    Source: reduced bit depth behind a wider output; missing codes of a converter.
    """

    name = "missing_codes"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER
    where = "signal"
    block = "comb"
    is_stepwise = True
    trials = (
        *({"step_codes": step} for step in _STEPS),
        *({"step_codes": step, "added_codes": step // 2.0} for step in _STEPS),
        {"step_codes": 3.0, "kept_codes": 2.0},
        {"step_codes": 4.0, "kept_codes": 2.0},
        {"step_codes": 4.0, "kept_codes": 3.0},
        {"step_codes": 8.0, "kept_codes": 7.0},
        {"step_codes": 16.0, "kept_codes": 15.0},
    )
    fitted = ()
    settles = "any capture with noise above three steps"
    step_codes: float = parameter(1.0, "1", 1.0, 1e9, source="period of the codes that occur")
    kept_codes: float = parameter(1.0, "1", 1.0, 1e9, source="codes of each period that occur")
    added_codes: float = parameter(0.0, "1", 0.0, 1e9, source="half a step where it is rounded to the nearest")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        lifted = signal + self.added_codes
        whole = self.step_codes * np.floor((lifted + 1e-6) / self.step_codes)
        return cast(Signal, whole + np.clip(np.floor(lifted - whole + 1e-6), 0.0, self.kept_codes - 1.0))

    def keeps_only_every(self, period: int) -> bool:
        return self.kept_codes == 1.0 and self.step_codes % period == 0.0

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        # What is cut off follows from the value in front of the rounding; cutting is lower by half a code.
        before = before.unrounded or before
        narrow2 = np.maximum(before.variance, 1e-6)
        u = before.mean + 0.5 + self.added_codes
        spread2 = narrow2 + before.spatial_variance
        cut, square, slope = _expected(u, spread2, round(self.step_codes), round(self.kept_codes))
        variance = np.maximum(narrow2 + square - cut**2 - 2.0 * narrow2 * slope, 0.0)
        # What pixels share goes by the mean slope, which no variable has beyond what its own variance becomes.
        most = np.sqrt(variance / narrow2)
        shared = before.passed(u - cut, np.clip(1.0 - slope, -most, most))
        after = shared.changed(variance=variance, spatial_variance=before.spatial_variance, unrounded=before)
        if not isinstance(after, TileMoments):
            return after
        return after.changed(comb_step=self.step_codes, comb_kept=self.kept_codes)
