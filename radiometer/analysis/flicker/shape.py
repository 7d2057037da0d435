"""The shape of light over one period: its extremes and its area above the mean, from samples at any rate.

Samples of many periods, sorted by phase, show the period more finely than one period of them does. Where a Fourier
series describes them within their noise, its extremes are those of the light between the samples as well. Steps need
more harmonics than samples support, so there the extremes are those of neighbouring phases.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import uniform_filter1d

from radiometer.analysis.flicker.waveform import Period, Waveform, harmonic_columns
from radiometer.data import Quantity
from radiometer.statistics.scale import jackknife_u
from radiometer.typing import Array

_MOST_POINTS: Final = 4096  # phases that are kept apart: a mean over one keeps 1 − 1e-7 of a sinusoid
_MOST_BLOCKS: Final = 16  # of periods, of which the scatter is taken
_GRID: Final = 2880  # phases at which a series is evaluated
_ORDERS: Final = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
_TAIL: Final = 2  # harmonics above those of the light: they show that the series ends, and their u counts
_SIGNIFICANT: Final = 12.0  # of χ² with two degrees of freedom: 0.25 % by chance
_STRUCTURED_SIGMAS: Final = 3.0
_MOST_OF_NOISE: Final = 1.5  # the trimmed noise of 32 points scatters by 18 %
_SAMPLES_PER_FACTOR: Final = 4  # of a series: fewer leave too few residuals to judge it by
_NEGLIGIBLE: Final = 1e-4  # of the fundamental's amplitude
_WORST_CONDITION: Final = 100.0  # of the normal equations: beyond it phases do not separate harmonics
LEAST_KEPT: Final = 0.2  # of an amplitude that an exposure keeps; below, the correction would amplify noise
_WINDOW: Final = 1 / 200  # of a period: mean over it before extremes of noisy phases are taken
_NOISELESS: Final = 1e-3  # of the range: noise below it needs no means
# Differences of neighbours: a tenth of them may be steps. The rest of a normal distribution has this variance.
_TRIMMED_SHARE, _TRIMMED_VARIANCE = 0.9, 0.623
_OTHER_LINE_BELOW_HZ: Final = 2000.0  # the band of the stroboscopic effect (IEC TR 63158)


@dataclass(frozen=True, slots=True)
class ShapeMeasures:
    """What a period's shape gives."""

    modulation_depth: Quantity  # (max − min)/(max + min)
    flicker_index: Quantity  # area above the mean over the whole area
    blocks: int  # blocks of periods whose scatter was taken; 0 where it was not
    is_series: bool  # whether a Fourier series describes the shape; the loss by exposure is then corrected
    phase: Array  # phases of the shape in periods, rising, shape (n,)
    light: Array  # light there, as it was sampled, shape (n,)


def measure_shape(waveform: Waveform, period: Period) -> ShapeMeasures:
    """Return modulation depth and flicker index of a period, with their standard uncertainty.

    The uncertainty of a series is that of its least squares, or the scatter between blocks of periods where that is
    larger. Between neighbouring phases it also covers what noise adds to extremes, and an extreme between two samples.
    """
    whole, parts = _folds(waveform, period)
    orders = _supported_orders(whole)
    kept = _kept(period.frequency_hz * waveform.averaged_s, orders[1] if orders else 1)

    def of(fold: _Fold) -> tuple[Array, Array]:
        return _of_series(fold, *orders, kept) if orders else _of_phases(fold)

    values, u = of(whole)
    u = np.maximum(u, jackknife_u([of(part)[0] for part in parts]))
    phase, light = whole.phase, whole.light
    if orders:
        phase = np.arange(_GRID) / _GRID
        light = harmonic_columns(phase, orders[1]) @ _Equations(whole, orders[1]).series(orders[1]).factors
    return _measures(values, u, len(parts), bool(orders), phase, light)


def measure_record(waveform: Waveform) -> ShapeMeasures:
    """Return modulation depth and flicker index of a whole record that no period describes."""
    size = waveform.light.size
    fold = _Fold(np.arange(size) / size, waveform.light, np.ones(size))
    power = _spectrum(waveform.light, waveform.rate_hz)[1] ** 2
    # The amplitude of a line of noise has the mean square 4σ²·Σw²/(Σw)²; for a Hann window Σw²/(Σw)² is 1.5/n.
    sigma = math.sqrt(float(np.median(power)) / math.log(2.0) * size / 6.0)
    values, u = _of_neighbours(fold, sigma, 1, 3)
    return _measures(values, u, 0, False, fold.phase, fold.light)


def _measures(values: Array, u: Array, blocks: int, is_series: bool, phase: Array, light: Array) -> ShapeMeasures:
    depth, index = (Quantity(float(value), float(one), "1") for value, one in zip(values, u, strict=True))
    return ShapeMeasures(depth, index, blocks, is_series, phase, light)


def other_line(
    waveform: Waveform, period: Period | None = None, shape: ShapeMeasures | None = None
) -> tuple[float, float] | None:
    """Return frequency in Hz and amplitude of the strongest line below 2 kHz that no period explains; None in noise."""
    left = waveform.light
    if period is not None and shape is not None:
        phase = np.arange(left.size) * period.frequency_hz / waveform.rate_hz % 1.0
        left = left - np.interp(phase, shape.phase, shape.light, period=1.0)
    frequency_hz, amplitude = _spectrum(left, waveform.rate_hz)
    looked_at = (frequency_hz * waveform.duration_s >= 1.5) & (frequency_hz <= _OTHER_LINE_BELOW_HZ)
    least = 0.0
    if period is not None and shape is not None:
        cycles = frequency_hz / period.frequency_hz
        # A Hann window spreads a line over two bins on either side.
        looked_at &= np.abs(cycles - np.round(cycles)) * period.frequency_hz * waveform.duration_s > 2.5
        least = float(np.ptp(shape.light)) * _NOISELESS
    if not looked_at.any():
        return None
    power = amplitude[looked_at] ** 2
    strongest = int(np.argmax(power))
    # The power of noise has an exponential distribution: ln n + 10 means are reached once in 20,000 records.
    by_chance = float(np.median(power)) / math.log(2.0) * (math.log(power.size) + 10.0)
    if power[strongest] <= max(by_chance, least**2):
        return None
    return float(frequency_hz[looked_at][strongest]), math.sqrt(float(power[strongest]))


def _spectrum(light: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return frequencies in Hz and amplitudes behind a Hann window."""
    window = np.hanning(light.size)
    amplitude = 2.0 * np.abs(rfft((light - light.mean()) * window)) / window.sum()
    return rfftfreq(light.size, 1.0 / rate_hz), amplitude


@dataclass(frozen=True, slots=True)
class _Fold:
    """Samples by phase: rising phases in periods, mean light and number of samples there."""

    phase: Array
    light: Array
    count: Array


def _folds(waveform: Waveform, period: Period) -> tuple[_Fold, list[_Fold]]:
    """Return all samples by phase, and those without one block of periods at a time."""
    size = waveform.light.size
    cycles = np.arange(size) * period.frequency_hz / waveform.rate_hz
    periods = int(size * period.frequency_hz / waveform.rate_hz + 1e-6)
    blocks = min(_MOST_BLOCKS, periods) if periods > 1 else 1
    phase: Array = np.asarray(cycles % 1.0, np.float64)
    if size > _MOST_POINTS:
        point, points = (phase * _MOST_POINTS).astype(np.intp), _MOST_POINTS
    else:
        point, points = np.empty(size, np.intp), size
        point[np.argsort(phase, kind="stable")] = np.arange(size)
    block = np.minimum((cycles * blocks / max(periods, 1)).astype(np.intp), blocks - 1)
    of_block = block * points + point

    def sums(weights: Array | None) -> Array:
        return np.bincount(of_block, weights, blocks * points).reshape(blocks, points).astype(np.float64)

    count, phases, light = sums(None), sums(phase), sums(waveform.light)

    def without(left_out: int | None) -> _Fold:
        kept = [n for n in range(blocks) if n != left_out]
        number = count[kept].sum(axis=0)
        seen = number > 0
        return _Fold(
            phases[kept].sum(axis=0)[seen] / number[seen], light[kept].sum(axis=0)[seen] / number[seen], number[seen]
        )

    return without(None), [without(n) for n in range(blocks)] if blocks > 1 else []


@dataclass(frozen=True, slots=True)
class _Series:
    """A Fourier series: mean, cosines, sines; their covariance; what it leaves of every phase."""

    factors: Array
    covariance: Array
    residual: Array

    def amplitude(self, harmonic: int) -> float:
        order = self.factors.size // 2
        return math.hypot(self.factors[harmonic], self.factors[order + harmonic])

    def variance(self, harmonic: int) -> float:
        order = self.factors.size // 2
        return float(self.covariance[harmonic, harmonic] + self.covariance[order + harmonic, order + harmonic]) / 2.0


class _Equations:
    """The least squares of series up to an order: columns and products are made once for all of them."""

    def __init__(self, fold: _Fold, most: int) -> None:
        self.fold, self.most = fold, most
        self._columns = harmonic_columns(fold.phase, most)
        weighted = self._columns * fold.count[:, None]
        self._products, self._moments = self._columns.T @ weighted, weighted.T @ fold.light

    def _of(self, order: int) -> Array:
        """Return which columns a series of an order has."""
        harmonics = np.arange(1, order + 1)
        return np.concatenate([[0], harmonics, self.most + harmonics])

    def series(self, order: int) -> _Series:
        """Return a series."""
        own = self._of(order)
        inverse = np.linalg.inv(self._products[np.ix_(own, own)])
        factors = inverse @ self._moments[own]
        residual = self.fold.light - self._columns[:, own] @ factors
        freedom = max(self.fold.phase.size - factors.size, 1)
        return _Series(factors, inverse * (float(self.fold.count @ residual**2) / freedom), residual)

    def determine(self, order: int) -> bool:
        """Return whether the phases determine a series."""
        if order > self.most:
            return False
        own = self._of(order)
        sizes = np.linalg.eigvalsh(self._products[np.ix_(own, own)])
        return bool(sizes[0] * _WORST_CONDITION > sizes[-1])


def _supported_orders(fold: _Fold) -> tuple[int, int] | None:
    """Return the order of the series that describes the light within its noise, and that which it is checked by.

    The second is about twice the first. Harmonics above the light's own must be insignificant, and the residuals must
    not follow the phase. None where no series fits.
    """
    noise = _noise(fold)
    enough = int((float(fold.count.sum()) / _SAMPLES_PER_FACTOR - 1.0) / 2.0)
    equations = _Equations(fold, min(2 * _ORDERS[-1], max(enough, 1)))
    for order in _ORDERS:
        # Light may have odd harmonics alone.
        twice = next((n for n in (max(2 * order, order + _TAIL), 2 * order) if equations.determine(n)), None)
        if twice is None:
            return None
        series = equations.series(twice)
        least = _NEGLIGIBLE * max(series.amplitude(n) for n in range(1, twice + 1))
        above = range(order + 1, min(order + _TAIL, twice) + 1)
        ends = all(series.amplitude(n) < max(least, math.sqrt(_SIGNIFICANT * series.variance(n))) for n in above)
        residual, negligible = series.residual * np.sqrt(fold.count), least * math.sqrt(fold.count.mean())
        # A series rings at steps: there the residuals are larger than the noise between neighbours.
        small = math.sqrt(float(np.mean(residual**2))) < _MOST_OF_NOISE * max(noise, negligible)
        if ends and small and _is_unstructured(residual, negligible):
            return order, twice
    return None


def _is_unstructured(residual: Array, negligible: float) -> bool:
    """Return whether neighbours differ as much as independent noise does (von Neumann 1941)."""
    squares = float(np.mean(residual**2))
    if squares <= negligible**2:
        return True
    ratio = float(np.mean((residual - np.roll(residual, 1)) ** 2)) / (2.0 * squares)
    return (1.0 - ratio) * math.sqrt(residual.size) < _STRUCTURED_SIGMAS


def _kept(averaged_periods: float, order: int) -> Array:
    """Return by how much an exposure scales each factor of a series; 1 where the loss cannot be corrected."""
    harmonics = np.sinc(averaged_periods * np.arange(1, order + 1))  # numpy's sinc holds the π
    harmonics[np.abs(harmonics) < LEAST_KEPT] = 1.0
    return np.concatenate([[1.0], harmonics, harmonics])


def _of_series(fold: _Fold, enough: int, order: int, kept: Array) -> tuple[Array, Array]:
    """Return modulation depth and flicker index of a series, and their standard uncertainties.

    A bend needs all harmonics: those above an order add to an extreme as 1/order. So what the orders from `enough` to
    twice that add is also what is still missing.
    """
    series = _Equations(fold, order).series(order)
    factors, covariance = series.factors / kept, series.covariance / np.outer(kept, kept)
    columns = harmonic_columns(np.arange(_GRID) / _GRID, order)
    light = columns @ factors
    top, bottom = int(np.argmax(light)), int(np.argmin(light))
    high, low, mean = float(light[top]), float(light[bottom]), float(factors[0])
    depth = (high - low) / (high + low)
    n = np.arange(factors.size)
    first = columns @ np.where(n - order * (n > order) <= enough, factors, 0.0)
    missing = abs(depth - np.ptp(first) / (first.max() + first.min()))
    towards_depth = 2.0 * (low * columns[top] - high * columns[bottom]) / (high + low) ** 2
    above = light > mean
    own = np.eye(factors.size)[0]
    index = float(np.mean(np.maximum(light - mean, 0.0))) / mean
    towards_index = ((columns - own) * above[:, None]).mean(axis=0) / mean - index / mean * own
    between = 1.0 - math.cos(math.pi * order / _GRID)  # of the amplitude, between two phases of the grid
    u = [math.sqrt(max(float(g @ covariance @ g), 0.0)) for g in (towards_depth, towards_index)]
    # Residuals that do not look like noise but are negligible may all be at an extreme.
    left = 0.0 if _is_unstructured(series.residual, 0.0) else float(np.std(series.residual)) / mean
    return np.array([depth, index]), np.hypot(np.hypot(u, abs(depth) * between + left), [missing, 0.0])


def _of_phases(fold: _Fold) -> tuple[Array, Array]:
    """Return modulation depth and flicker index of a period in steps, and their standard uncertainties."""
    sigma = _noise(fold)
    wide = max(1, round(fold.phase.size * _WINDOW)) if sigma > _NOISELESS * float(np.ptp(fold.light)) else 1
    # Phases of few periods may be bunched: a mean reaches from bunch to bunch.
    bunch = float(np.diff(fold.phase, append=fold.phase[0] + 1.0).max()) * fold.phase.size
    return _of_neighbours(fold, sigma, wide, 2 * (wide - 1) + round(3.0 * bunch))


def _of_neighbours(fold: _Fold, sigma: float, wide: int, wider: int) -> tuple[Array, Array]:
    """Return modulation depth and flicker index from means of neighbouring points, and their standard uncertainties.

    A sample has the standard deviation `sigma`, a mean `wide` points. Means flatten an extreme, and it may be between
    two samples: what `wider` means flatten it by counts.
    """
    depth, middle, slopes, added, sigma_mean = _depth(fold, sigma, wide)
    flattened = abs(depth - _depth(fold, sigma, min(wider, fold.phase.size))[0])
    gaps = np.diff(fold.phase, append=fold.phase[0] + 1.0)
    share = (gaps + np.roll(gaps, 1)) / 2.0
    mean = float(share @ fold.light)
    index = float(share @ np.maximum(fold.light - mean, 0.0)) / mean
    steps = np.diff(fold.light, append=fold.light[0]) * gaps  # a step may be anywhere between two samples
    near = float(share[np.abs(fold.light - mean) < 2.0 * sigma].sum())  # noise is rectified where light is the mean
    u_index = [
        float(np.linalg.norm(steps)) / math.sqrt(12.0), 0.4 * near * sigma,
        sigma / math.sqrt(float(fold.count.sum())),
    ]  # fmt: skip
    u_depth = [added / math.sqrt(12.0) / middle, sigma_mean * slopes, flattened]
    return np.array([depth, index]), np.array([math.hypot(*u_depth), math.hypot(*u_index) / mean])


def _depth(fold: _Fold, sigma: float, wide: int) -> tuple[float, float, float, float, float]:
    """Return the modulation depth of running means, the middle between the extremes, and the depth's slope over noise.

    Noise adds between nothing (sharp extremes) and √(2·ln n) standard deviations (flat ones): half is taken off. That
    most and the standard deviation of a mean come last. The means go around the period's end.
    """
    above, count = (uniform_filter1d(one, wide, mode="wrap") for one in (fold.light * fold.count, fold.count))
    light, sigma_mean = above / count, sigma / math.sqrt(wide * float(np.median(count)))
    added = sigma_mean * math.sqrt(2.0 * math.log(max(light.size / wide, 2.0)))
    high, low = float(light.max()) - added / 2.0, float(light.min()) + added / 2.0
    slopes = 2.0 * math.hypot(high, low) / (high + low) ** 2
    return (high - low) / (high + low), (high + low) / 2.0, slopes, added, sigma_mean


def _noise(fold: _Fold) -> float:
    """Return the standard deviation of a sample, from the differences of neighbouring phases; few of them are steps."""
    after = np.roll(fold.count, -1)
    differences = (np.roll(fold.light, -1) - fold.light) * np.sqrt(fold.count * after / (fold.count + after))
    squares = np.sort(differences**2)[: max(1, int(_TRIMMED_SHARE * differences.size))]
    return math.sqrt(float(squares.mean()) / _TRIMMED_VARIANCE)
