"""Penalised fits of a response to group means; one nuisance value (ln E) per group is eliminated before solving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
from numpy.typing import NDArray

from radiometer.analysis.response.basis import ValueBasis
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.errors import MeasurementError
from radiometer.statistics.model_choice import STATED_IS_WRONG, is_supported
from radiometer.statistics.scale import penalised_terms
from radiometer.typing import Array

# What a curve over the digital numbers itself can be off by in ln H: no row is known better.
_LEAST_ERROR = 1e-4
# Relative standard deviations of the exposure times that are tried; none is always among the choices.
_TIME_SPREADS = (0.001, 0.003, 0.01, 0.03)
# ln of true over stated time of a frame whose label is not believed, and its standard deviation.
UNKNOWN_LABEL = (0.0, 3.0)
# A part of the data that decides more of the fit than this has no residual that shows its error.
_MOST_LEVERAGE = 0.95
_SMOOTHINGS = np.logspace(-6, 9, 31)
# No covariance is inverted beyond this standard uncertainty of ln of an exposure: rounding.
_LEAST_U_LOG = 1e-6
_UNDETERMINED = (
    "the frames do not determine a response: too few values overlap between exposures; "
    "take exposures about one stop apart of a scene with many brightnesses"
)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations N·c = q of Σ w (X·c − y − e_group)² with every e_group at its best value."""

    matrix: Array  # N, shape (k, k)
    right: Array  # q, shape (k,)
    square: float  # Σ w (y − ȳ_group)²
    freedom: int  # rows minus groups
    centred: Array  # X with its weighted group means taken away, shape (rows, k): the rows that remain
    target: Array  # y with its weighted group mean taken away, shape (rows,)
    weight: Array  # w, shape (rows,)
    group: NDArray[np.intp]  # group of every row, ascending

    def residuals(self, solution: Array) -> Array:
        """Return y − X·c + e of every row at a solution, each group's e at its best value."""
        return self.target - self.centred @ solution

    def rms(self, solution: Array) -> float:
        """Return the weighted root mean square of the residuals."""
        return float(np.sqrt(self.weight @ self.residuals(solution) ** 2 / self.weight.sum()))

    def covariance(self, solution: Array, inverse: Array) -> Array:
        """Return the covariance of a solution from the scatter of whole groups' scores, with no noise model assumed."""
        starts = np.flatnonzero(np.diff(self.group, prepend=-1))
        weighted = self.centred * (self.weight * self.residuals(solution))[:, None]
        scores = np.add.reduceat(weighted, starts, axis=0)
        groups = max(scores.shape[0], 2)
        return np.asarray(inverse @ (scores.T @ scores * (groups / (groups - 1.0))) @ inverse)

    def smoothness(self, inverse: Array) -> Array:
        """Return the part of the posterior covariance that the penalty decides: what it may have bent."""
        return np.asarray(inverse - inverse @ self.matrix @ inverse)


def eliminate_groups(design: sp.csr_array, target: Array, weight: Array, group: NDArray[np.intp]) -> NormalEquations:
    """Return the normal equations of the curve alone, every group's ln E eliminated (Schur complement).

    Args:
        design: X, shape (rows, k).
        target: y, shape (rows,).
        weight: Inverse variances up to a factor, above 0, shape (rows,).
        group: Group of every row, ascending from 0 without gaps.
    """
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    total = np.add.reduceat(weight, starts)
    # A row has few entries and a group few rows: sums over groups are made while the design is sparse.
    over_group = sp.csr_array((weight, np.arange(target.size), np.append(starts, target.size)))
    mean_design = (over_group @ design).toarray() / total[:, None]
    mean_target = np.add.reduceat(target * weight, starts) / total
    centred = design.toarray()
    # Dense matrices of all rows are some megabytes each: one for what is taken away, and then for what is weighted.
    scaled = np.take(mean_design, group, axis=0)
    centred -= scaled
    centred_target = target - mean_target[group]
    root = np.sqrt(weight)
    np.multiply(centred, root[:, None], out=scaled)
    return NormalEquations(
        matrix=scaled.T @ scaled,
        right=scaled.T @ (root * centred_target),
        square=float(weight @ centred_target**2),
        freedom=int(target.size - starts.size),
        centred=centred,
        target=centred_target,
        weight=weight,
        group=group,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PenalisedSolution:
    """Solution of (N + λP)·c = q under the gauge b·c = 0."""

    coefficients: Array  # c, shape (k,)
    inverse: Array  # (N + λP + gauge)⁻¹, shape (k, k)
    smoothing: float  # λ
    residual_variance: float  # weighted residual variance with the effective number of parameters taken off
    effective_parameters: float  # trace of the smoother


def solve_penalised(
    normal: NormalEquations, penalty: Array, gauge: Array, smoothing: float | None = None, *, order: int = 3
) -> PenalisedSolution:
    """Return the penalised solution; λ by restricted maximum likelihood where none is given.

    Args:
        penalty: P, positive semi-definite, shape (k, k).
        gauge: b; the solution obeys b·c = 0, which the equations themselves leave open.
        smoothing: λ at or above 0; None to choose it.
        order: Dimensions that the penalty leaves free (the order of its difference).

    Raises:
        MeasurementError: If the data leave the curve undetermined.

    Source: restricted likelihood of a smoothing parameter, Wood 2011, J. R. Stat. Soc. B 73, 3–36, section 2.
    """
    scale = float(np.trace(normal.matrix)) / max(float(np.trace(penalty)), 1e-300)
    # The equations do not change along the gauge direction, so any positive multiple pins it exactly.
    fixed = normal.matrix + np.outer(gauge, gauge) * float(np.trace(normal.matrix)) / float(gauge @ gauge)
    if smoothing is not None:
        return _finish(normal, penalty, fixed, smoothing * scale, smoothing)
    grid = np.logspace(-12, 7, 39)
    scores = [_restricted_deviance(normal, penalty, fixed, value * scale, order) for value in grid]
    if not np.isfinite(np.min(scores)):
        raise MeasurementError(_UNDETERMINED)
    best = float(grid[int(np.argmin(scores))])
    return _finish(normal, penalty, fixed, best * scale, best)


def _restricted_deviance(normal: NormalEquations, penalty: Array, fixed: Array, weight: float, order: int) -> float:
    explained, log_det = penalised_terms(fixed + weight * penalty, normal.right)
    fit = normal.square - explained  # residual and penalty together at the optimum
    # A curve through every mean (two frames: as many coefficients as rows) would have no error, and λ go to nothing.
    fit = max(fit, 0.0) + _LEAST_ERROR**2 * float(normal.weight.sum())
    rank = penalty.shape[0] - order
    # What the penalty leaves free takes its dimensions; a constant, one of them, the groups have taken already.
    freedom = max(normal.freedom - (order - 1), 1)
    return float(freedom * np.log(max(fit, 1e-300)) + log_det - rank * np.log(weight))


def _finish(
    normal: NormalEquations, penalty: Array, fixed: Array, weight: float, smoothing: float
) -> PenalisedSolution:
    full = fixed + weight * penalty
    try:
        inverse = la.cho_solve(la.cho_factor(full, lower=True), np.eye(full.shape[0]))
    except la.LinAlgError as error:
        raise MeasurementError(
            f"the response is undetermined at smoothing {smoothing:g}; use a larger one, or none to have it chosen"
        ) from error
    solution = inverse @ normal.right
    residual = normal.residuals(solution)
    parameters = float(np.sum(inverse * normal.matrix))
    freedom = max(normal.freedom - parameters, 1.0)
    return PenalisedSolution(solution, inverse, smoothing, float(normal.weight @ residual**2) / freedom, parameters)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseFit:
    """A fitted response."""

    coefficients: Array  # of the basis
    inverse: Array  # posterior covariance of the coefficients (and time errors), shape (k, k)
    normal: NormalEquations  # the normal equations that were solved
    smoothing: float  # λ relative to tr(N)/tr(P)
    time_spread: float  # relative standard deviation of the exposure times that was assumed; 0 where taken as exact
    time_modes: Array  # amplitudes of the patterns in the exposure times; empty where exact
    # Ln of true over stated time that one unit of each amplitude makes in every frame, shape (frames, modes)
    patterns: Array
    basis_size: int  # number of coefficients that belong to the curve
    reduced_chi2: float  # of the residuals

    @property
    def log_time_errors(self) -> Array:
        """Return ln of true over stated exposure time of every frame."""
        return np.asarray(self.patterns @ self.time_modes)

    @property
    def solution(self) -> Array:
        """Return coefficients and time errors together as they were solved for."""
        return np.concatenate([self.coefficients, self.time_modes])

    def covariance(self) -> Array:
        """Return the covariance of the solution."""
        return self.normal.covariance(self.solution, self.inverse)

    def frame_covariance(self, frame: NDArray[np.intp]) -> Array:
        """Return the covariance of the solution that whole frames make that are each off in their own way.

        Every frame's score counts as one draw, because its residuals share flare, tone or shutter. The part that the
        fit absorbed is restored: with leverage H, a frame's residual is (I − H)^½ of its error.

        Source: R. M. Bell, D. F. McCaffrey 2002, Survey Methodology 28, 169–181 (the estimator named CR2).
        """
        normal = self.normal
        # Its smallest eigenvalues may come out below zero where penalty and data differ by many decades.
        values, vectors = np.linalg.eigh(0.5 * (self.inverse + self.inverse.T))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        residual = normal.residuals(self.solution) / np.sqrt(1.0 - np.minimum(self._share_of_group(), _MOST_LEVERAGE))
        rows = normal.centred @ root
        draws = []
        for one in np.unique(frame):
            here = frame == one
            weighted = rows[here] * normal.weight[here, None]
            taken_up, axes = np.linalg.eigh(weighted.T @ rows[here])
            score = axes.T @ (weighted.T @ residual[here])
            draws.append(root @ (axes @ (score / np.sqrt(1.0 - np.clip(taken_up, 0.0, _MOST_LEVERAGE)))))
        return np.asarray(np.transpose(draws) @ np.array(draws))

    def smoothness_covariance(self) -> Array:
        """Return the part of the posterior covariance that the smoothness (and the prior of the times) decides."""
        return self.normal.smoothness(self.inverse)

    def leverage(self) -> Array:
        """Return the part of each row's own noise that curve and group took up, 0 to 0.95."""
        normal, own = self.normal, self._share_of_group()
        curve = np.einsum("ij,ij->i", normal.centred @ self.inverse, normal.centred) * normal.weight
        return np.asarray(np.clip(own + curve, 0.0, _MOST_LEVERAGE))

    def _share_of_group(self) -> Array:
        """Return the part of its group's weight that each row has: so much of its noise the group's mean takes up."""
        normal = self.normal
        starts = np.flatnonzero(np.diff(normal.group, prepend=-1))
        return np.asarray(normal.weight / np.add.reduceat(normal.weight, starts)[normal.group])


def fit_response(
    samples: ResponseSamples,
    dn: Array,
    variance: Array,
    *,
    time_spread: float | None = None,
    smoothing: float | None = None,
    free: Sequence[int] = (),
    known: Sequence[tuple[float, float]] = (),
    u_offset_s: float = 0.0,
) -> ResponseFit:
    """Return the response that best explains group means of known variance.

    λ and, where the data call for it, the spread of the exposure times maximise the restricted likelihood.

    Args:
        dn: Their digital numbers (of the mean exposure), shape (rows,).
        variance: Variance of ln H of every row, shape (rows,).
        time_spread: Relative standard deviation of the exposure times; 0 for exact ones, None to decide by the data.
        smoothing: λ relative to tr(N)/tr(P); None to have it chosen.
        free: Frames whose exposure is not taken from their label.
        known: ln of true over stated exposure of each of these and its standard uncertainty, where other data say so.
        u_offset_s: Standard deviation in s of a time by which all exposures are longer than stated, as one more
            amplitude (in units of this) after those of the freed frames; 0 for none.

    Raises:
        MeasurementError: If the data leave the curve undetermined.
    """
    smoothings = _SMOOTHINGS if smoothing is None else np.array([smoothing])
    spreads = (0.0, *_TIME_SPREADS) if time_spread is None else (time_spread,)
    if np.unique(samples.frame_log_time).size <= 2:
        spreads = (0.0,)
    basis = ValueBasis(samples.bit_depth, samples.limits)
    design = basis.design(dn)
    labels = np.eye(samples.frame_log_time.size)[:, list(free)]
    expected = np.array(known or [UNKNOWN_LABEL] * len(free)).reshape(-1, 2)
    if u_offset_s:
        labels = np.column_stack([labels, u_offset_s / samples.exposures_s])
        expected = np.vstack([expected, (0.0, 1.0)])

    def equations(patterns: Array) -> NormalEquations:
        columns = [design, sp.csr_array(-patterns[samples.frame])] if patterns.shape[1] else [design]
        return eliminate_groups(
            sp.csr_array(sp.hstack(columns, format="csr")), samples.log_time, 1.0 / variance, samples.group
        )

    def problem(normal: NormalEquations, patterns: Array, spread: float) -> _Problem:
        return _Problem.of(normal, basis, samples, patterns, expected, spread, smoothings)

    chosen = problem(equations(labels), labels, 0.0) if 0.0 in spreads else None
    if any(spreads):
        modes = np.hstack([labels, time_error_modes(samples.frame_log_time)])
        with_times = equations(modes)
        freest = min((problem(with_times, modes, one) for one in spreads if one), key=lambda one: one.deviance)
        if chosen is None or is_supported(chosen.deviance - freest.deviance, STATED_IS_WRONG):
            chosen = freest
    if chosen is None or not np.isfinite(chosen.deviance):
        raise MeasurementError(_UNDETERMINED)
    return chosen.solved()


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Normal equations with gauge and penalty at the λ of least restricted deviance."""

    normal: NormalEquations
    right: Array
    fixed: Array
    penalty: Array
    smoothing: float
    deviance: float
    time_spread: float
    patterns: Array
    basis_size: int

    @classmethod
    def of(
        cls,
        normal: NormalEquations,
        basis: ValueBasis,
        samples: ResponseSamples,
        patterns: Array,
        expected: Array,
        spread: float,
        smoothings: Array,
    ) -> _Problem:
        free = len(expected)
        size = normal.matrix.shape[0]
        middle = np.zeros(size)
        middle[: basis.size] = basis.values_at(basis.anchor_dn)
        trace = float(np.trace(normal.matrix[: basis.size, : basis.size]))
        fixed = normal.matrix + np.outer(middle, middle) * trace / float(middle @ middle)
        labels = np.arange(basis.size, basis.size + free)
        fixed[labels, labels] += expected[:, 1] ** -2.0
        right = normal.right.copy()
        right[labels] += expected[:, 0] * expected[:, 1] ** -2.0
        prior = 0.0
        if spread:
            errors = np.arange(basis.size + free, size)
            fixed[errors, errors] += 1.0 / spread**2
            prior = 2.0 * errors.size * float(np.log(spread))
        penalty = np.zeros((size, size))
        roughness = basis.roughness()
        penalty[: basis.size, : basis.size] = roughness * trace / float(np.trace(roughness))
        rank = basis.size - basis.roughness_order
        if smoothings.size == 1:
            scores = [0.0]
        else:
            scores = [_deviance(normal.square, right, fixed, penalty, value, rank) + prior for value in smoothings]
        at = int(np.argmin(scores))
        return cls(normal, right, fixed, penalty, float(smoothings[at]), scores[at], spread, patterns, basis.size)

    def solved(self) -> ResponseFit:
        try:
            inverse = np.linalg.inv(self.fixed + self.smoothing * self.penalty)
        except np.linalg.LinAlgError as error:
            raise MeasurementError(_UNDETERMINED) from error
        solution = inverse @ self.right
        parameters = float(np.sum(inverse * self.normal.matrix))
        chi2 = float(self.normal.weight @ self.normal.residuals(solution) ** 2)
        return ResponseFit(
            coefficients=solution[: self.basis_size],
            inverse=np.asarray(inverse, dtype=np.float64),
            normal=self.normal,
            smoothing=self.smoothing,
            time_spread=self.time_spread,
            time_modes=solution[self.basis_size :],
            patterns=self.patterns,
            basis_size=self.basis_size,
            reduced_chi2=chi2 / max(self.normal.freedom - parameters, 1.0),
        )


def information(covariance: Array) -> Array:
    """Return the inverse of a covariance of logarithms of exposures, also where one is known exactly or not at all.

    Args:
        covariance: Symmetric but for rounding, shape (n, n).
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors / np.maximum(values, _LEAST_U_LOG**2) @ vectors.T)


def _deviance(square: float, right: Array, fixed: Array, penalty: Array, smoothing: float, rank: int) -> float:
    """Return −2 ln of the restricted likelihood up to a constant, the rows' variances being as stated."""
    explained, log_det = penalised_terms(fixed + smoothing * penalty, right)
    return square - explained + log_det - rank * float(np.log(smoothing))


def time_error_modes(log_time: Array) -> Array:
    """Return the patterns of time errors that change neither the mean nor the scale of ln t, shape (frames, modes).

    A common factor is the gauge of g; errors proportional to ln t are its exponent, which only the stated times fix.
    """
    fixed = np.column_stack([np.ones(log_time.size), log_time])
    return np.asarray(la.null_space(fixed.T))
