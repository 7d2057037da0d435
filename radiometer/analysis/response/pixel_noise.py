"""The noise of single pixels behind a response curve, from how well a stack's own frames predict each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from radiometer.analysis.response.basis import hat_weight
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.noise import LogNoise, group_deviation, slope_at, value_at
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.data.frame import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.data.sensor_noise import SensorNoise
from radiometer.errors import MeasurementError
from radiometer.typing import Array

_PIXELS: Final = 6000  # noise parameters are then known to some per cent
_FEWEST_ROWS: Final = 50  # fewer do not separate shot from read noise
_ROUNDS: Final = 6  # of the weights, which follow the fitted noise
# Rounding alone, in DN²: no stack is quieter.
_ROUNDING_DN2: Final = 1.0 / 12.0
# Electrons of a sensor whose shot noise a stack does not show: many enough to weigh nothing.
_MOST_ELECTRONS: Final = 1e7
# Standard deviations that a wild residual (movement, a defect) counts at most; and where much of a scene may move.
_WILD: Final = 5.0
_OUTER: Final = 1.0
# Square of the length at which two separable unit columns differ, beyond what sums in double precision lose.
_ALIKE: Final = 1e-13
_TOO_FEW: Final = "hardly a pixel is unclipped in two frames: the noise of the stack cannot be measured"


@dataclass(frozen=True, slots=True, eq=False)
class SinglePixels:
    """Some thousand pixels evenly over the picture, each with its rows by frame."""

    samples: ResponseSamples  # one group per pixel
    row: NDArray[np.intp]  # row of the picture of every group, shape (groups,)
    column: NDArray[np.intp]  # column of every group
    log_h: Array  # g at the rows' digital numbers, shape (rows,)
    slope: Array  # g' in 1/DN there

    @classmethod
    def of(cls, bracket: Bracket, curve: ResponseCurve) -> SinglePixels:
        """Return the pixels of a lattice whose step shares no factor with the blocks of JPEG, borders left out.

        Raises:
            MeasurementError: If hardly a pixel is unclipped in two frames.
        """
        rows, columns = _lattice(bracket.shape)
        dn = np.array([frame.dn[rows[:, None], columns].ravel() for frame in bracket.light], dtype=np.float64).T
        samples, pixel = _samples(bracket, curve, dn)
        g = finite(curve.log_exposure)
        log_h, slope = value_at(g, samples.dn), slope_at(g, samples.dn, samples)
        return cls(samples, rows[pixel // columns.size], columns[pixel % columns.size], log_h, slope)

    def noise_terms(self) -> Array:
        """Return what unit amplitudes of shot, read and digital noise make of the variance, shape (rows, 3)."""
        return np.column_stack([np.exp(-self.log_h), np.exp(-2.0 * self.log_h), self.slope**2])


@dataclass(frozen=True, slots=True, eq=False)
class TermsFit:
    """Amplitudes of terms of the variance, fitted to squared residuals."""

    amplitudes: Array  # at or above 0, shape (terms,)
    information: Array  # weighted normal matrix, shape (terms, terms)
    score: Array  # each row's part in the normal equations at the solution, shape (rows, terms)

    def covariance(self, part: NDArray[np.intp]) -> Array:
        """Return the covariance of the amplitudes from how far parts of the picture are from it.

        Args:
            part: Which part every row belongs to; residuals within one may be alike in any way.

        Source: K.-Y. Liang, S. L. Zeger 1986, Biometrika 73, 13–22 (the sandwich over clusters).
        """
        sums = np.zeros((int(part.max()) + 1, self.amplitudes.size))
        np.add.at(sums, part, self.score)
        inverse = np.linalg.pinv(self.information)
        return np.asarray(inverse @ (sums.T @ sums) @ inverse)


def log_noise(amplitudes: Array) -> LogNoise:
    """Return the noise of amplitudes in the order of `SinglePixels.noise_terms`; further ones are left out."""
    return LogNoise(float(amplitudes[0]), float(amplitudes[1]), float(amplitudes[2]), 0.0)


def fit_terms(pixels: SinglePixels, terms: Array) -> TermsFit:
    """Return the amplitudes of terms of the variance of ln H of single pixels.

    Args:
        terms: What a unit amplitude of each makes of the variance of every row; the third is noise in DN².
    """
    samples = pixels.samples
    hat = hat_weight(samples.dn, samples.limits) ** 2 + 1e-6
    start = np.zeros(terms.shape[1])
    start[2] = 1.0
    values, rounding = pixels.log_h - samples.log_time, _ROUNDING_DN2 * pixels.slope**2
    return _fit_variance(values, samples.group, terms, rounding, hat, start, _WILD)


def excess_noise(x: Array, exposure: Array, shot: float, dark: Array, rounding: Array) -> Array:
    """Return the factors, 1 at least, by which variances of frames exceed assumed ones: with light, and without.

    Differences of neighbours leave out what frames differ by as a whole: flicker, the shutter, most of what moves.

    Args:
        x: Signal of some pixels and a neighbour of each in every frame, shape (frames, 2, pixels); nan where it clips.
        exposure: Of every frame, shape (frames,).
        shot: Assumed variance of shot noise per unit of x.
        dark: Assumed variance of x without light, shape (frames,).
        rounding: Variance of x that `dark` does not hold and that is known, of the shape of x.

    Raises:
        MeasurementError: If hardly a pixel is unclipped in two frames.
    """
    counts = np.isfinite(x).all(axis=1)
    pixel, frame = np.nonzero((counts & (counts.sum(axis=0) >= 2)).T)
    if pixel.size < _FEWEST_ROWS:
        raise MeasurementError(_TOO_FEW)
    group, t = np.unique(pixel, return_inverse=True)[1].astype(np.intp), exposure[frame]
    one, other = x[frame, :, pixel].T
    rate = np.bincount(group, (one + other) / 2.0) / np.bincount(group, t)
    terms = np.column_stack([shot * np.maximum(rate[group], 0.0) / t, dark[frame] / t**2])
    # Of frames without noise at all a thousandth of the assumed one remains.
    known = rounding.mean(axis=1)[frame, pixel] / t**2 + 1e-6 * terms.sum(axis=1)
    values = (one - other) / (math.sqrt(2.0) * t)
    return np.maximum(_fit_variance(values, group, terms, known, np.ones(t.size), np.ones(2), _OUTER).amplitudes, 1.0)


def _fit_variance(
    values: Array, group: NDArray[np.intp], terms: Array, known: Array, trust: Array, start: Array, most: float
) -> TermsFit:
    """Return the amplitudes of terms of the variance of rows, from how far they are from the mean of their group.

    Args:
        values: Of the rows, shape (rows,).
        group: Of every row, ascending.
        terms: What a unit amplitude of each makes of the variance of every row, shape (rows, terms).
        known: Variance that every row has besides.
        trust: Weight of every row besides its variance.
        start: First amplitudes.
        most: Standard deviations that a residual counts at most.
    """
    terms = np.asfortranarray(terms)  # few columns of many rows: each in one piece
    parts, amplitudes = np.column_stack([terms, known]), start
    for _ in range(_ROUNDS):
        residual, share = group_deviation(values, group, trust / (terms @ amplitudes + known))
        fit = _fitted(residual, _of_residuals(group, parts, share), amplitudes, most)
        amplitudes = fit.amplitudes
    return fit


def _of_residuals(group: NDArray[np.intp], terms: Array, share: Array) -> Array:
    """Return what unit amplitudes make of the variance of each residual about the mean of its group.

    With shares p the residual e_i − Σ p_j e_j has the variance (1 − 2 p_i) σ_i² + Σ p_j² σ_j².
    """
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    of_mean = np.add.reduceat(share[:, None] ** 2 * terms, starts, axis=0)
    return np.asarray((1.0 - 2.0 * share)[:, None] * terms + of_mean[group])


def _fitted(residual: Array, parts: Array, start: Array, most: float) -> TermsFit:
    """Return the amplitudes, at or above 0, that make the squared residuals; the last part of the variance is known.

    Source: Var(r²) = 2σ⁴ for Gaussian residuals, so that 1/σ⁴ weights a regression of r² on its expectation.
    """
    # The mean square of a normal residual of which no more counts.
    beyond = math.erfc(most / math.sqrt(2.0))
    part = 1.0 - beyond - most * math.sqrt(2.0 / math.pi) * math.exp(-0.5 * most**2) + most**2 * beyond
    square, terms, known = residual**2, parts[:, :-1], parts[:, -1]
    found = start
    for _ in range(_ROUNDS):
        expected = np.maximum(terms @ found + known, 1e-300)
        target = (np.minimum(square, most**2 * expected) / part - known) / expected
        weighted = terms / expected[:, None]
        found = _least_squares_above_zero(weighted, target)
    left = target - weighted @ found
    return TermsFit(np.asarray(found), weighted.T @ weighted, weighted * left[:, None])


def _least_squares_above_zero(columns: Array, target: Array) -> Array:
    """Return the coefficients x ≥ 0 of least |A·x − y|²: those of as few rows as columns, with the same AᵀA and Aᵀy.

    Args:
        columns: A, shape (rows, k).
        target: y, shape (rows,).
    """
    gram, right = columns.T @ columns, columns.T @ target
    scale = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
    square, directions = np.linalg.eigh(gram / np.outer(scale, scale))
    length = np.sqrt(np.maximum(square, _ALIKE))
    return np.asarray(nnls((directions * length).T, directions.T @ (right / scale) / length)[0] / scale)


def sensor_noise(noise: LogNoise, curve: ResponseCurve, black_dn: float = 0.0) -> SensorNoise:
    """Return the same noise as electrons of a sensor, with what arises behind the curve in DN².

    x = exp g has the variance a·x + b + d·(dx/dM)², so that 1/a is the number of electrons at x = 1.

    Args:
        curve: The response that it holds for.
    """
    _, high = curve.valid_dn or (1, curve.log_exposure.size - 2)
    top = float(np.exp(curve.log_exposure[high]))
    electrons_per_unit = min(1.0 / max(noise.shot, 1e-300), _MOST_ELECTRONS / top)
    return SensorNoise(
        # Electrons per DN as a straight line from black to the last number with data would have it.
        conversion_gain_e_per_dn=electrons_per_unit * top / (high - black_dn),
        read_noise_e=float(np.sqrt(noise.read)) * electrons_per_unit,
        full_well_e=electrons_per_unit * top,
        post_curve_dn2=noise.digital,
    )


def finite(log_exposure: Array) -> Array:
    """Return a curve with its ends held where it says nothing.

    Args:
        log_exposure: g at every digital number; infinite where it says nothing.
    """
    known = np.flatnonzero(np.isfinite(log_exposure))
    return np.interp(np.arange(log_exposure.size), known, log_exposure[known])


def _lattice(shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pixels that represent all; each has neighbours on all sides."""
    step = max(1, int(np.sqrt(shape[0] * shape[1] / _PIXELS)))
    step += (step + 1) % 2
    first = max(step // 2, 1)
    return np.arange(first, shape[0] - 1, step), np.arange(first, shape[1] - 1, step)


def _samples(bracket: Bracket, curve: ResponseCurve, dn: Array) -> tuple[ResponseSamples, NDArray[np.intp]]:
    """Return one group per pixel that two frames show, and which pixel each is; dn of shape (pixels, frames)."""
    low, high = curve.valid_dn or (1, curve.log_exposure.size - 2)
    inside = (dn >= low) & (dn <= high)
    inside &= (inside.sum(axis=1) >= 2)[:, None]
    pixel, frame = np.nonzero(inside)
    if pixel.size < _FEWEST_ROWS:
        raise MeasurementError(_TOO_FEW)
    log_time = np.log(bracket.effective_exposures_s)
    seen, group = np.unique(pixel, return_inverse=True)
    samples = ResponseSamples(
        dn=dn[pixel, frame],
        log_time=log_time[frame],
        group=group.astype(np.intp),
        frame=frame,
        pixels=np.ones(pixel.size),
        variance=np.full(pixel.size, _ROUNDING_DN2),
        bit_depth=bracket.bit_depth,
        limits=ValueLimits(max(low - 1, 0), min(high + 1, curve.log_exposure.size - 1)),
        frame_log_time=log_time,
        pixel_count=dn.shape[0],
        channel=curve.channel,
    )
    return samples, seen
