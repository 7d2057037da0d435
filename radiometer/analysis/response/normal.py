"""Penalised least squares with one nuisance value (ln E) per group of pixels, eliminated before solving."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
from numpy.typing import NDArray

from radiometer.errors import MeasurementError
from radiometer.statistics.restricted_likelihood import penalised_terms
from radiometer.typing import Array

# What a curve over the digital numbers itself can be off by in ln H: no row is known better.
_LEAST_ERROR = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations N·c = q of Σ w (X·c − y − e_group)² with every e_group at its best value.

    Attributes:
        matrix: N, shape (k, k).
        right: q, shape (k,).
        square: Σ w (y − ȳ_group)².
        freedom: Rows minus groups.
        centred: X with its weighted group means taken away, shape (rows, k): the rows that remain.
        target: y with its weighted group mean taken away, shape (rows,).
        weight: w, shape (rows,).
        group: Group of every row, ascending.
    """

    matrix: Array
    right: Array
    square: float
    freedom: int
    centred: Array
    target: Array
    weight: Array
    group: NDArray[np.intp]

    def residuals(self, solution: Array) -> Array:
        """Return y − X·c + e of every row at a solution, each group's e at its best value."""
        return self.target - self.centred @ solution

    def robust_meat(self, solution: Array) -> Array:
        """Return Σ_g s_g·s_gᵀ of the groups' scores: the covariance of q with no noise model assumed."""
        starts = np.flatnonzero(np.diff(self.group, prepend=-1))
        weighted = self.centred * (self.weight * self.residuals(solution))[:, None]
        scores = np.add.reduceat(weighted, starts, axis=0)
        groups = max(scores.shape[0], 2)
        return np.asarray(scores.T @ scores * (groups / (groups - 1.0)))


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
    """Solution of (N + λP)·c = q under the gauge b·c = 0.

    Attributes:
        coefficients: c, shape (k,).
        inverse: (N + λP + gauge)⁻¹, shape (k, k).
        smoothing: λ.
        residual_variance: Weighted residual variance with the effective number of parameters taken off.
        effective_parameters: Trace of the smoother.
    """

    coefficients: Array
    inverse: Array
    smoothing: float
    residual_variance: float
    effective_parameters: float


def solve_penalised(
    normal: NormalEquations, penalty: Array, gauge: Array, smoothing: float | None = None, *, order: int = 3
) -> PenalisedSolution:
    """Return the penalised solution; λ by restricted maximum likelihood where none is given.

    Args:
        normal: The normal equations.
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
        raise MeasurementError(
            "the frames do not determine a response: too few values overlap between exposures; "
            "take exposures about one stop apart of a scene with many brightnesses"
        )
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
