"""One fit of the best estimate, and what it settles on before: noise, smoothness, how many tones and places count.

Behind a real camera what a response curve cannot follow (flare, registration, mixed colours) is alike in neighbouring
tones and alike within a part of the picture. Groups of pixels counted as independent would then call for every wave
that they share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.basis import ValueBasis, hat_weight
from radiometer.analysis.response.curves import rising, supported_range
from radiometer.analysis.response.estimate import inner_range
from radiometer.analysis.response.fit import ResponseFit, fit_response, information
from radiometer.analysis.response.left_out import error_dn, prediction_error_dn
from radiometer.analysis.response.noise import (
    LogNoise,
    dn_at,
    fit_log_noise,
    group_residual,
    mean_exposure_dn,
    noise_of,
    row_variance,
    slope_at,
    value_at,
)
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.errors import MeasurementError
from radiometer.typing import Array

# The sum over correlations ends where two neighbouring ones together are no longer clearly positive.
_LEAST_PAIR: Final = 0.1
# Pairs of tones fewer than this share of all say too little of a correlation.
_LEAST_SHARE: Final = 0.25
# Four quadrants know a variance so badly that only a ratio above this is not chance: χ² of three differences of two
# independent features of a curve exceeds it once in a thousand stacks.
_BY_CHANCE: Final = 4.0
# Below this the rounding to whole numbers is a large part of the exposure. The cut is made on the value that the
# other frames predict. A cut on the noisy value itself would keep the brighter half.
_LEAST_PREDICTED_DN: Final = 6.0
# Inflations within this factor of each other are the same; more rounds than this change nothing.
_SETTLED, _ROUNDS = 1.2, 4


def tones_as_one(residual: Array, group: NDArray[np.intp], frame: NDArray[np.intp]) -> float:
    """Return how many neighbouring groups count as one tone, at least 1: 1 + 2 Σ ρ over their distance.

    Args:
        residual: Standardised residuals of the rows of a fit, shape (rows,).
        group: Group of every row; groups ascend in brightness.
        frame: Frame of every row.

    Source: integrated autocorrelation with an initial positive sequence, C. J. Geyer 1992, Stat. Sci. 7, 473–483,
    section 3.3.
    """
    groups = int(group.max()) + 1
    product, pairs = np.zeros(groups), np.zeros(groups)
    for one in np.unique(frame):
        rows = frame == one
        line, there = np.zeros(groups), np.zeros(groups)
        line[group[rows]], there[group[rows]] = residual[rows], 1.0
        product += _correlation(line)
        pairs += _correlation(there)
    known = pairs > _LEAST_SHARE * pairs[0]
    correlation = product / np.maximum(pairs, 1.0) / max(float(product[0] / pairs[0]), 1e-300)
    total = 1.0
    for lag in range(1, groups - 1, 2):
        pair = float(correlation[lag] + correlation[lag + 1])
        if pair <= _LEAST_PAIR or not known[lag + 1]:
            break
        total += 2.0 * pair
    return total


def _correlation(line: Array) -> Array:
    """Return Σ_i x_i x_(i+lag) for every lag."""
    spectrum = np.fft.rfft(line, 2 * line.size)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2)[: line.size])


def places_as_one(between: Array, expected: Array) -> float:
    """Return by how much parts of the picture differ beyond the scatter of their groups, as a ratio of variances.

    Args:
        between: Variance of the curve by leaving out quadrants, over the supported digital numbers.
        expected: Its variance from the scatter of groups taken as independent.

    Returns:
        The ratio; 1 where it may be chance.
    """
    ratio = float(np.mean(between)) / max(float(np.mean(expected)), 1e-300)
    return ratio if ratio > _BY_CHANCE else 1.0


@dataclass(frozen=True, slots=True)
class Choices:
    """What a fit takes as given."""

    inflation: float = 1.0  # how many neighbouring groups count as one; variances are multiplied by it
    smoothing: float | None = None  # λ relative to tr(N)/tr(P); None to choose it by the restricted likelihood
    time_spread: float | None = 0.0  # relative standard deviation of the exposure times; None to choose it
    free: tuple[int, ...] = ()  # frames whose exposure is not taken from their label
    known: tuple[tuple[float, float], ...] = ()  # what other data say of these, as in `fit_response`
    noise: LogNoise | None = None  # noise of the stack; None to take it from the residuals
    # Standard deviation in s of a time that all exposures share beyond their labels, as in `fit_response`; 0 for none
    u_offset_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FittedResponse:
    """A fit with its curve."""

    samples: ResponseSamples  # the rows that were used
    dn: Array  # their digital numbers (of the mean exposure)
    fit: ResponseFit  # the fit
    choices: Choices  # what it took as given or settled on
    log_exposure: Array  # g at every digital number, rising, free offset

    @property
    def noise(self) -> LogNoise:
        """Return the noise of the stack."""
        if self.choices.noise is None:
            raise AssertionError("a fit always knows its noise")
        return self.choices.noise

    @property
    def label_covariance(self) -> Array:
        """Return the posterior covariance of ln of real over stated exposure of the freed frames."""
        labels = slice(self.fit.basis_size, self.fit.basis_size + len(self.choices.free))
        return self.fit.inverse[labels, labels]

    @property
    def offset_s(self) -> tuple[float, float]:
        """Return the time in s by which all exposures are longer than the samples', and its standard uncertainty."""
        place = len(self.choices.free)
        scale, row = self.choices.u_offset_s, self.fit.basis_size + place
        return scale * float(self.fit.time_modes[place]), scale * float(np.sqrt(self.fit.inverse[row, row]))

    def u_of(self, covariance: Array) -> Array:
        """Return the standard uncertainty of g from that of the anchor that a covariance of the solution makes."""
        inner = covariance[: self.fit.basis_size, : self.fit.basis_size]
        every = self._basis.all_values()
        middle = self._basis.values_at(self._basis.anchor_dn)
        with_middle = inner @ middle
        square = self._basis.variances(inner) - 2.0 * (every @ with_middle) + middle @ with_middle
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))

    @property
    def relative(self) -> Array:
        """Return g from that of the anchor, before it was made rising."""
        g = self._basis.all_values() @ self.fit.coefficients
        return np.asarray(g - g[self._basis.anchor_dn])

    @property
    def _basis(self) -> ValueBasis:
        return ValueBasis(self.samples.bit_depth, self.samples.limits)

    @property
    def residual_rms_log(self) -> float:
        """Return the root mean square of ln H residuals, weighted."""
        return self.fit.normal.rms(self.fit.solution)


def fit_with(samples: ResponseSamples, start: Array, choices: Choices) -> FittedResponse:
    """Return the fit under given choices.

    Args:
        start: A first estimate of g at every digital number, rising.
    """
    samples = _above_black(samples, start)
    limits = samples.limits
    shifted = mean_exposure_dn(samples.dn, samples.variance, start, limits)
    dn = np.clip(shifted, limits.black_dn, limits.saturated_dn)
    found = choices.noise or noise_of(samples, dn, start)

    def fitted(near: Array, noise: LogNoise, time_spread: float | None) -> ResponseFit:
        variance = row_variance(samples, dn, near, noise) * choices.inflation
        return fit_response(
            samples,
            dn,
            variance,
            time_spread=time_spread,
            smoothing=choices.smoothing,
            free=choices.free,
            known=choices.known,
            u_offset_s=choices.u_offset_s,
        )

    fit = fitted(start, found, choices.time_spread)
    if choices.noise is None and fit.time_modes.size:
        # Wrong times looked like noise before: take the noise from the residuals, and fit once more.
        g = _values(samples, fit)
        left = fit.normal.residuals(fit.solution)
        found = fit_log_noise(left, fit.leverage(), value_at(g, dn), slope_at(g, dn, samples), samples.pixels)
        fit = fitted(g, found, fit.time_spread)
    settled = replace(choices, smoothing=fit.smoothing, time_spread=fit.time_spread, noise=found)
    return FittedResponse(samples, dn, fit, settled, _values(samples, fit))


def settle(
    samples: ResponseSamples,
    start: Array,
    free: tuple[int, ...] = (),
    time_spread: float | None = 0.0,
    known: tuple[tuple[float, float], ...] = (),
    u_offset_s: float = 0.0,
) -> FittedResponse:
    """Return the fit whose smoothness counts tones and places, not groups of pixels, as independent.

    Args:
        start: A first estimate of g at every digital number, rising.
        free: Frames whose exposure is not taken from their label.
        time_spread: Relative standard deviation of the exposure times; None to choose it.
        known: What other data say of the freed frames, as in `fit_response`.
        u_offset_s: Standard deviation in s of a time that all exposures share beyond their labels; 0 for none.
    """
    choices = Choices(free=free, known=known, time_spread=time_spread, u_offset_s=u_offset_s)
    found = fit_with(samples, start, choices)
    for _ in range(_ROUNDS):
        inflation = max(found.choices.inflation, _inflation(samples, found))
        if inflation <= found.choices.inflation * _SETTLED:
            break
        found = fit_with(samples, start, replace(choices, inflation=inflation))
    return found


def refit(part: ResponseSamples, found: FittedResponse) -> FittedResponse | None:
    """Return the same fit to a part of the data, with the smoothness of the whole; None where that says too little."""
    try:
        return fit_with(part, found.log_exposure, found.choices)
    except MeasurementError:
        return None


def given_labels(found: FittedResponse, log_ratios: Array) -> FittedResponse:
    """Return the fit at other values of its freed labels: the curve that is best with these.

    Args:
        found: A fit with freed labels.
        log_ratios: ln of real over stated exposure of each of them.
    """
    fit = found.fit
    rows = slice(fit.basis_size, fit.basis_size + log_ratios.size)
    towards = fit.inverse[:, rows] @ information(found.label_covariance)
    solution = fit.solution + towards @ (log_ratios - fit.time_modes[: log_ratios.size])
    moved = replace(fit, coefficients=solution[: fit.basis_size], time_modes=solution[fit.basis_size :])
    return replace(found, fit=moved, log_exposure=_values(found.samples, moved))


def error_of_quadrants(samples: ResponseSamples, fitted: FittedResponse, frame: int | None = None) -> Array:
    """Return the mean size of the prediction error in DN of every quadrant, fitted without it.

    Args:
        fitted: A fit to all of them.
        frame: The frame whose rows are predicted; None for all. NaN where a quadrant has none.
    """
    found = []
    for train, test in zip(samples.without_quadrant, samples.quadrants, strict=True):
        part = refit(train, fitted) or fitted
        errors = prediction_error_dn(test, part.log_exposure, part.fit.log_time_errors)
        if frame is not None:
            errors = errors[test.frame == frame]
        found.append(error_dn(errors) if np.any(np.isfinite(errors)) else float("nan"))
    return np.array(found)


def _inflation(samples: ResponseSamples, found: FittedResponse) -> float:
    fit, rows = found.fit, found.samples
    g = found.log_exposure
    left, taken_up = fit.normal.residuals(fit.solution), fit.leverage()
    noise = fit_log_noise(left, taken_up, value_at(g, found.dn), slope_at(g, found.dn, rows), rows.pixels)
    sigma = np.sqrt(row_variance(rows, found.dn, g, noise) * np.maximum(1.0 - taken_up, 0.05))
    tones = tones_as_one(left / sigma, rows.group, rows.frame)
    parts = [refit(part, found) for part in samples.without_quadrant]
    curves = np.array([part.relative for part in parts if part is not None])
    if len(curves) < 3:
        return tones
    inner = inner_range(supported_range(rows))
    between = (len(curves) - 1) * curves.var(axis=0)
    places = places_as_one(between[inner], found.u_of(fit.covariance())[inner] ** 2)
    # The quadrants themselves are taken as independent: no stack says less than so many tones would.
    return max(tones, min(places, rows.group_count / len(curves)))


def _values(samples: ResponseSamples, fit: ResponseFit) -> Array:
    basis = ValueBasis(samples.bit_depth, samples.limits)
    g = np.asarray(basis.all_values() @ fit.coefficients)
    u = np.sqrt(np.maximum(basis.variances(fit.inverse[: fit.basis_size, : fit.basis_size]), 0.0))
    return rising(g, u, supported_range(samples), samples.limits.black_dn)


def _above_black(samples: ResponseSamples, log_exposure: Array) -> ResponseSamples:
    """Return the rows whose predicted value is clear of black, groups with one such row left out."""
    weight = (hat_weight(samples.dn, samples.limits) ** 2 + 1e-6) * samples.pixels
    log_h = value_at(log_exposure, samples.dn)
    predicted_log_h = log_h - group_residual(samples, log_h, weight)[0]
    keep = dn_at(log_exposure, predicted_log_h) > samples.limits.black_dn + _LEAST_PREDICTED_DN
    return samples.kept(keep)
