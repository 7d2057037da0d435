"""Predicts each setting from the others: leave-one-group-out of a linear model, without refitting.

Let r be the residual of the full fit and H its hat matrix. A group's prediction error is (I − H_g)⁻¹·r_g with that
covariance. Hence ln p = −½·r_gᵀ(I − H_g)⁻¹r_g + ½·ln|I − H_g|. The hat matrix of the nuisances is factored once;
effects, freed of what the nuisances explain, add V·Vᵀ to it, which Woodbury's identity takes in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from radiometer.reconciliation.fit.linear import LinearFit, RowBlock, triangular
from radiometer.typing import Array

_RIDGE: Final = 1e-9  # a parameter that one group alone determines leaves nothing to predict it by
_SMALLEST: Final = 1e-12


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Quality of the prediction of each group of rows from the others."""

    log_density: Array  # (groups,) log predictive density, constants left out
    chi2: Array  # (groups,) squared standardised residual under the predictive covariance
    count: Array  # (groups,) entries that count


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Rows of one group that count; those that nuisances touch stand at `touched` among them."""

    number: int
    rows: NDArray[np.intp]
    touched: NDArray[np.intp]
    whitened: Array  # (nuisances, touched): columns of L⁻¹·Nᵀ
    factor: Array  # Cholesky factor of I − WᵀW, or of I − W·Wᵀ where that is smaller
    is_dual: bool
    log_determinant: float

    def solve(self, right: Array) -> Array:
        """Return (I − H_g)⁻¹ · right, (rows, n), for the nuisances' hat matrix."""
        found = right.copy()
        part = right[self.touched]
        if self.is_dual:
            found[self.touched] += self.whitened.T @ cho_solve((self.factor, True), self.whitened @ part)
        elif part.size:
            found[self.touched] = cho_solve((self.factor, True), part, check_finite=False)
        return found


@dataclass(frozen=True, eq=False)
class Groups:
    """The rows of a fit by groups, with the nuisances' hat matrix factored."""

    nuisances: RowBlock  # the nuisances' columns
    group: NDArray[np.intp]  # (rows,) group of each row, from 0
    counts: NDArray[np.bool_]  # (rows,) which rows count

    @cached_property
    def size(self) -> int:
        """Return the number of groups."""
        return int(self.group.max()) + 1

    @cached_property
    def _whitened(self) -> Array:
        return triangular(self.nuisances.factor, self.nuisances.values.T)

    @cached_property
    def number(self) -> Array:
        """Return how many rows of each group count."""
        return np.bincount(self.group[self.counts], minlength=self.size).astype(np.float64)

    @cached_property
    def _position(self) -> NDArray[np.intp]:
        """Return for each row its place among those that nuisances touch; −1 for the others."""
        position = np.full(self.group.size, -1, dtype=np.intp)
        position[self.nuisances.rows] = np.arange(self.nuisances.rows.size)
        return position

    @cached_property
    def single(self) -> tuple[NDArray[np.intp], Array]:
        """Return groups of one row each (priors): their rows, and 1 − H for the nuisances."""
        rows = np.flatnonzero(self.counts & (self.number[self.group] == 1))
        at = self._position[rows]
        hat = np.where(at >= 0, np.sum(self._whitened[:, np.maximum(at, 0)] ** 2, axis=0), 0.0)
        return rows, np.maximum(1.0 - hat, _RIDGE)

    @cached_property
    def large(self) -> tuple[_Group, ...]:
        """Return the groups of several rows."""
        return tuple(self._large())

    def _large(self) -> Iterator[_Group]:
        rows = np.flatnonzero(self.counts & (self.number[self.group] > 1))
        rows = rows[np.argsort(self.group[rows], kind="stable")]
        bounds = np.flatnonzero(np.diff(self.group[rows], prepend=-1, append=-1))
        for low, high in pairwise(bounds):
            mine = rows[low:high]
            touched = np.flatnonzero(self._position[mine] >= 0)
            whitened = self._whitened[:, self._position[mine[touched]]]
            is_dual = touched.size > whitened.shape[0]
            hat = whitened @ whitened.T if is_dual else whitened.T @ whitened
            factor = np.asarray(np.linalg.cholesky((1.0 + _RIDGE) * np.eye(hat.shape[0]) - hat))
            log_determinant = 2.0 * float(np.sum(np.log(np.diag(factor))))
            yield _Group(int(self.group[mine[0]]), mine, touched, whitened, factor, is_dual, log_determinant)


def leave_one_group_out(fit: LinearFit, groups: Groups) -> HeldOut:
    """Return how well each group of rows is predicted by the others, exactly for the linearised model.

    Args:
        fit: The linear fit; its nuisances are those of `groups`.
    """
    effects, residual = _freed(fit), fit.projected
    log_density, chi2 = np.zeros(groups.size), np.zeros(groups.size)
    both = np.column_stack([effects, residual])
    for entry in groups.large:
        mine = both[entry.rows]
        products = mine.T @ entry.solve(mine)
        chi2[entry.number], shrink = _reduced(products)
        log_density[entry.number] = 0.5 * (entry.log_determinant + shrink)
    rows, left = groups.single
    share = np.sum(effects[rows] ** 2, axis=1) / left
    kept = np.maximum(1.0 - share, _SMALLEST)
    chi2[groups.group[rows]] = residual[rows] ** 2 / left / kept
    log_density[groups.group[rows]] = 0.5 * np.log(left * kept)
    return HeldOut(log_density - 0.5 * chi2, chi2, groups.number)


def _freed(fit: LinearFit) -> Array:
    """Return V with V·Vᵀ the effects' part of the hat matrix: the effects freed of the nuisances, orthonormal."""
    lengths = np.linalg.norm(fit.effects, axis=0)
    freed = fit.effects[:, lengths > 0] / lengths[lengths > 0]
    if not freed.shape[1]:
        return np.asarray(freed)
    known = fit.nuisances
    half = triangular(known.factor, known.pull(freed))
    pulled = triangular(known.factor, half, transposed=True)
    freed[known.rows] -= known.values @ pulled
    values, vectors = np.linalg.eigh(freed.T @ freed)
    kept = values > _RIDGE
    return np.asarray(freed @ (vectors[:, kept] / np.sqrt(values[kept])))


def _reduced(products: Array) -> tuple[float, float]:
    """Return (χ², ln determinant) after the effects, from their products and the residual's by (I − H_g)⁻¹."""
    count = products.shape[0] - 1
    values, vectors = np.linalg.eigh(np.eye(count) - products[:count, :count])
    values = np.maximum(values, _RIDGE)
    pulled = vectors.T @ products[:count, count]
    return float(products[count, count] + np.sum(pulled**2 / values)), float(np.sum(np.log(values)))
