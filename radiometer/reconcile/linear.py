"""Least squares on the whitened vector, linearised: projection, score tests, leave-one-setting-out prediction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from radiometer.reconcile.design import Array


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Residual = J·Δ + noise of unit variance, priors standing as further rows.

    Attributes:
        residual: Whitened residual at the point of linearisation, priors included.
        jacobian: −d(residual)/d(parameter), (rows, parameters).
    """

    residual: Array
    jacobian: Array

    @cached_property
    def normal(self) -> Array:
        """Return JᵀJ."""
        return np.asarray(self.jacobian.T @ self.jacobian)

    @cached_property
    def factor(self) -> Array:
        """Return the lower Cholesky factor of JᵀJ, a little ridge keeping it regular."""
        scale = np.sqrt(np.maximum(np.diag(self.normal), 1e-300))
        ridge = np.diag(1e-12 * scale**2)
        return np.asarray(np.linalg.cholesky(self.normal + ridge))

    @cached_property
    def step(self) -> Array:
        """Return the change of the parameters that minimises the residual."""
        return self.solve(self.jacobian.T @ self.residual)

    def solve(self, right: Array) -> Array:
        """Return (JᵀJ)⁻¹ · right."""
        half = solve_triangular(self.factor, right, lower=True)
        return np.asarray(solve_triangular(self.factor, half, lower=True, trans="T"))

    def half(self, right: Array) -> Array:
        """Return L⁻¹ · right for JᵀJ = L·Lᵀ."""
        return np.asarray(solve_triangular(self.factor, right, lower=True))

    @property
    def covariance(self) -> Array:
        """Return (JᵀJ)⁻¹, the parameters' covariance."""
        return self.solve(np.eye(self.jacobian.shape[1]))

    @cached_property
    def projected(self) -> Array:
        """Return the residual after the best change of the parameters."""
        return np.asarray(self.residual - self.jacobian @ self.step)

    def project(self, rows: Array) -> Array:
        """Return vectors (rows, n) freed of what the parameters can explain."""
        return np.asarray(rows - self.jacobian @ self.solve(self.jacobian.T @ rows))

    def extended(self, columns: Array, residual: Array | None = None) -> LinearFit:
        """Return the fit with further columns, and possibly another residual."""
        return LinearFit(self.residual if residual is None else residual, np.hstack([self.jacobian, columns]))

    def score(self, rows: slice, basis: Array) -> tuple[float, int]:
        """Return (χ², rank) of what a basis that touches only some rows would explain beside the parameters.

        Args:
            rows: Rows that the basis touches.
            basis: Its whitened columns, (rows, terms).
        """
        lengths = np.linalg.norm(basis, axis=0)
        basis = basis[:, lengths > 0] / lengths[lengths > 0]
        if not basis.size:
            return 0.0, 0
        part = self.half(self.jacobian[rows].T @ basis)
        gram = basis.T @ basis - part.T @ part
        right = basis.T @ self.projected[rows]
        values, vectors = np.linalg.eigh(gram)
        kept = values > 1e-6
        if not kept.any():
            return 0.0, 0
        return float(np.sum((vectors[:, kept].T @ right) ** 2 / values[kept])), int(kept.sum())


@dataclass(frozen=True, slots=True)
class HeldOut:
    """How well each group of rows is predicted by the others.

    Attributes:
        log_density: (groups,) log predictive density, constants left out.
        chi2: (groups,) squared standardised residual under the predictive covariance.
        count: (groups,) entries that count.
    """

    log_density: Array
    chi2: Array
    count: Array


def leave_one_group_out(fit: LinearFit, group: NDArray[np.intp], counts: NDArray[np.bool_]) -> HeldOut:
    """Return the exact leave-one-group-out prediction of a linear model, without refitting.

    With r the residual of the full fit and H its hat matrix, the group's own prediction error is (I − H_g)⁻¹·r_g
    and its covariance (I − H_g)⁻¹, so that ln p = −½·r_gᵀ(I − H_g)⁻¹r_g + ½·ln|I − H_g|. By Woodbury only matrices
    of the size of the parameters occur: (I − H_g)⁻¹ = I + J_g·(A − J_gᵀJ_g)⁻¹·J_gᵀ.

    Args:
        fit: The linear fit; rows beyond `group` (priors) are groups of their own.
        group: Group of each row, from 0.
        counts: Which rows count.
    """
    groups = int(group.max()) + 1
    log_density, chi2, number = np.zeros(groups), np.zeros(groups), np.zeros(groups)
    log_total = 2.0 * float(np.sum(np.log(np.diag(fit.factor))))
    order = np.argsort(group, kind="stable")
    bounds = np.searchsorted(group[order], np.arange(groups + 1))
    for g in range(groups):
        rows = order[bounds[g] : bounds[g + 1]]
        rows = rows[counts[rows]]
        number[g] = rows.size
        if not rows.size:
            continue
        part, residual = fit.jacobian[rows], fit.projected[rows]
        rest = fit.normal - part.T @ part
        factor, lower = cho_factor(rest + np.diag(1e-9 * np.diag(fit.normal) + 1e-300), lower=True)
        pulled = part.T @ residual
        chi2[g] = float(residual @ residual + pulled @ cho_solve((factor, lower), pulled))
        shrink = 2.0 * float(np.sum(np.log(np.diag(factor)))) - log_total
        log_density[g] = -0.5 * chi2[g] + 0.5 * shrink
    return HeldOut(log_density, chi2, number)
