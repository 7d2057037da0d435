"""Least squares on the whitened vector, linearised: projection, score tests, settings predicted from the others.

The nuisances touch few of the statistics (the means, mostly), the effects any: their columns are kept apart.

Leaving a group out needs no refit. Let r be the residual of the full fit and H its hat matrix. A group's prediction
error is (I − H_g)⁻¹·r_g with that covariance. Hence ln p = −½·r_gᵀ(I − H_g)⁻¹r_g + ½·ln|I − H_g|. The hat matrix of the
nuisances is factored once; effects, freed of what the nuisances explain, add V·Vᵀ to it, which Woodbury's identity
takes in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dtrtrs

from radiometer.typing import Array

_RIDGE = 1e-12  # relative; keeps a Cholesky factor regular
_OWN_SHARE = 1e-4  # of a trend's square that the parameters must leave for it to be tested


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Columns that are zero but in some rows."""

    rows: NDArray[np.intp]  # (n,) those rows, rising
    values: Array  # (n, columns) what stands there

    @classmethod
    def of(cls, matrix: Array) -> RowBlock:
        """Return the block of a matrix."""
        rows = np.flatnonzero(matrix.any(axis=1))
        return cls(rows, matrix[rows])

    def joined_with(self, other: RowBlock, size: int, below: Array) -> RowBlock:
        """Return the block joined with another, and with further rows below both that have one entry each.

        Args:
            below: (columns,) the entry of each column in its row.
        """
        rows = np.union1d(self.rows, other.rows)
        values = np.zeros((rows.size + below.size, below.size))
        own, theirs = values[: rows.size, : self.columns], values[: rows.size, self.columns :]
        own[np.searchsorted(rows, self.rows)] = self.values
        theirs[np.searchsorted(rows, other.rows)] = other.values
        values[rows.size :] = np.diag(below)
        found = RowBlock(np.concatenate([rows, size + np.arange(below.size)]), values)
        across = own.T @ theirs
        normal = np.block([[self.normal, across], [across.T, other.normal]])  # a block that stays has its own already
        vars(found)["normal"] = normal + np.diag(below**2)
        return found

    def within(self, place: NDArray[np.intp]) -> RowBlock:
        """Return the block in rows that have other places, by the place of each; −1 for those that are left out."""
        own = place[self.rows]
        order = np.argsort(own)[np.count_nonzero(own < 0) :]
        return RowBlock(own[order], self.values[order])

    @property
    def columns(self) -> int:
        """Return the number of columns."""
        return int(self.values.shape[1])

    @cached_property
    def normal(self) -> Array:
        """Return NᵀN."""
        return np.asarray(self.values.T @ self.values)

    @cached_property
    def factor(self) -> Array:
        """Return the lower Cholesky factor of NᵀN."""
        return cholesky(self.normal)

    def times(self, weights: Array, size: int) -> Array:
        """Return N·w of all rows, (size,) or (size, n)."""
        found = np.zeros((size, *weights.shape[1:]))
        found[self.rows] = self.values @ weights
        return found

    def pull(self, vectors: Array, start: int = 0) -> Array:
        """Return Nᵀ·v for vectors whose entries begin at row `start`, (entries,) or (entries, n)."""
        low, high = np.searchsorted(self.rows, [start, start + vectors.shape[0]])
        return np.asarray(self.values[low:high].T @ vectors[self.rows[low:high] - start])


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Residual = N·a + E·b + noise of unit variance, priors standing as further rows."""

    residual: Array  # whitened residual at the point of linearisation, priors included, followers followed
    nuisances: RowBlock  # N = −d(residual)/d(nuisance)
    effects: Array  # E = −d(residual)/d(effect parameter), (rows, parameters), followers followed
    followers: RowBlock  # the same as N in rows that follow the nuisances but do not determine them

    @classmethod
    def of(cls, residual: Array, nuisances: RowBlock, effects: Array, followers: RowBlock) -> LinearFit:
        """Return the fit of a residual and of effect columns in which the followers stand still."""
        bare = cls(residual, nuisances, np.zeros((residual.size, 0)), followers)
        moved, pulled = bare._followed(np.column_stack([residual, effects]))
        found = cls(np.ascontiguousarray(moved[:, 0]), nuisances, moved[:, 1:], followers)
        vars(found)["_pulled"] = pulled
        return found

    def without(self, effects: Sequence[int]) -> LinearFit:
        """Return the fit in which some effect parameters stay where they are, by position."""
        found = replace(self, effects=np.delete(self.effects, effects, axis=1))
        vars(found)["_pulled"] = np.delete(self._pulled, [1 + place for place in effects], axis=1)
        return found

    @cached_property
    def _pulled(self) -> Array:
        """Return Nᵀ·[residual, E]: the nuisances are many, and reading them is what takes time."""
        return self.nuisances.pull(np.column_stack([self.residual, self.effects]))

    @cached_property
    def normal(self) -> Array:
        """Return JᵀJ for J = [N, E]."""
        cross = self._pulled[:, 1:]
        return np.block([[self.nuisances.normal, cross], [cross.T, self.effects.T @ self.effects]])

    @cached_property
    def factor(self) -> Array:
        """Return the lower Cholesky factor of JᵀJ, a little ridge keeping it regular: that of NᵀN, and a border."""
        known, border = self.nuisances.columns, _triangular(self.nuisances.factor, self._pulled[:, 1:])
        found = np.zeros((known + border.shape[1],) * 2)
        found[:known, :known], found[known:, :known] = self.nuisances.factor, border.T
        found[known:, known:] = cholesky(self.effects.T @ self.effects, border.T @ border)
        return found

    @cached_property
    def step(self) -> Array:
        """Return the change of the parameters that minimises the residual."""
        return self.solve(self._slope)

    @property
    def gain(self) -> float:
        """Return the χ² that the parameters take up."""
        return float(self._slope @ self.step)

    @cached_property
    def _slope(self) -> Array:
        return np.concatenate([self._pulled[:, 0], self.effects.T @ self.residual])

    def step_from(self, residual: Array) -> tuple[Array, float]:
        """Return the same step from another point's residual, followers not followed yet, and what χ² it promises."""
        pulled = self.pull(self.followed(residual))
        step = self.solve(pulled)
        return step, float(pulled @ step)

    def pull(self, vectors: Array, start: int = 0) -> Array:
        """Return Jᵀ·v for vectors whose entries begin at row `start`, (entries,) or (entries, n)."""
        own = self.effects[start : start + vectors.shape[0]].T @ vectors
        return np.concatenate([self.nuisances.pull(vectors, start), own])

    def followed(self, vectors: Array) -> Array:
        """Return vectors with the followers where the nuisances take them: v − F·(NᵀN)⁻¹·Nᵀ·v; not to be done twice.

        Args:
            vectors: (entries,) or (entries, n); prior rows may be left out.
        """
        return self._followed(vectors)[0] if self.followers.rows.size else vectors.copy()

    def followed_with_half(self, vectors: Array) -> tuple[Array, Array]:
        """Return `followed(vectors)` and L⁻¹·Jᵀ of it, the part that the parameters take up.

        Args:
            vectors: (entries, n); prior rows may be left out.
        """
        moved, pulled = self._followed(vectors)
        own = self.effects[: moved.shape[0]].T @ moved
        return moved, self.half(np.concatenate([pulled, own]))

    def _followed(self, vectors: Array) -> tuple[Array, Array]:
        pulled = self.nuisances.pull(vectors)
        if not self.followers.rows.size:
            return vectors.copy(), pulled
        half = _triangular(self.nuisances.factor, pulled)
        led = _triangular(self.nuisances.factor, half, transposed=True)[: self.followers.columns]
        moved = vectors.copy()
        moved[self.followers.rows] -= self.followers.values @ led
        return moved, pulled - self._crossed @ led

    @cached_property
    def _crossed(self) -> Array:
        _, own, theirs = np.intersect1d(
            self.nuisances.rows, self.followers.rows, assume_unique=True, return_indices=True
        )
        return np.asarray(self.nuisances.values[own].T @ self.followers.values[theirs])

    def solve(self, right: Array) -> Array:
        """Return (JᵀJ)⁻¹ · right."""
        return _triangular(self.factor, self.half(right), transposed=True)

    def half(self, right: Array) -> Array:
        """Return L⁻¹ · right for JᵀJ = L·Lᵀ."""
        return _triangular(self.factor, right)

    @property
    def covariance(self) -> Array:
        """Return (JᵀJ)⁻¹, the parameters' covariance."""
        return self.solve(np.eye(self.factor.shape[0]))

    @cached_property
    def projected(self) -> Array:
        """Return the residual after the best change of the parameters."""
        known = self.nuisances.columns
        left = self.residual - self.effects @ self.step[known:]
        left[self.nuisances.rows] -= self.nuisances.values @ self.step[:known]
        return np.asarray(left)

    def within(self, rows: NDArray[np.intp]) -> LinearFit:
        """Return the fit as vectors see it that are zero outside some rows, all those of the followers among these.

        Args:
            rows: The rows, in the order in which the vectors have them.
        """
        place = np.full(self.residual.size, -1, dtype=np.intp)
        place[rows] = np.arange(rows.size)
        nuisances, followers = (block.within(place) for block in (self.nuisances, self.followers))
        found = LinearFit(self.residual[rows], nuisances, self.effects[rows], followers)
        vars(nuisances)["factor"] = self.nuisances.factor
        vars(found).update({"factor": self.factor, "_crossed": self._crossed})
        return found

    def extended(self, columns: Array, residual: Array | None = None) -> LinearFit:
        """Return the fit with further effect columns, and possibly another residual, followers followed in both."""
        changed = self.residual if residual is None else residual
        return LinearFit(changed, self.nuisances, np.hstack([self.effects, columns]), self.followers)

    def left_of(self, vector: Array) -> Array:
        """Return what the best change of the parameters leaves of a vector in place of the residual.

        Args:
            vector: (entries,), followers not followed yet; prior rows left out.
        """
        padded = np.concatenate([vector, np.zeros(self.residual.size - vector.size)])
        return replace(self, residual=self.followed(padded)).projected[: vector.size]

    def score(self, rows: slice, basis: Array, part: Array | None = None) -> tuple[float, int]:
        """Return (χ², rank) of what a basis that touches only some rows would explain in addition to the parameters.

        Args:
            rows: Rows that the basis touches.
            basis: Its whitened columns, (rows, terms).
            part: L⁻¹·Jᵀ·basis, where it is known already.
        """
        products = basis.T @ basis
        lengths = np.sqrt(np.diag(products))
        there = lengths > 0
        if not there.any():
            return 0.0, 0
        taken = self.half(self.pull(basis, rows.start)) if part is None else part
        unit = np.diag(1.0 / lengths[there])
        gram = unit @ (products - taken.T @ taken)[np.ix_(there, there)] @ unit
        right = unit @ (basis.T @ self.projected[rows])[there]
        values, vectors = np.linalg.eigh(gram)
        kept = values > _OWN_SHARE
        if not kept.any():
            return 0.0, 0
        return float(np.sum((vectors[:, kept].T @ right) ** 2 / values[kept])), int(kept.sum())


def cholesky(normal: Array, less: Array | float = 0.0) -> Array:
    """Return the lower Cholesky factor of a normal matrix, with a small ridge that keeps it regular."""
    ridge = _RIDGE * np.maximum(np.diag(normal), 1e-300)
    return np.asarray(np.linalg.cholesky(normal + np.diag(ridge) - less))


def _triangular(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    """Return L⁻¹·right or L⁻ᵀ·right for a lower Cholesky factor; LAPACK's own, for most systems are small."""
    if not right.size:
        return np.zeros(right.shape)
    # LAPACK reads columns first: our rows are the transpose to it, the upper factor Lᵀ.
    found, singular = dtrtrs(factor.T, right, lower=0, trans=0 if transposed else 1)
    if singular:
        raise np.linalg.LinAlgError(f"row {singular} of a Cholesky factor is nothing")
    return np.asarray(found)


# ---- settings held out ----------------------------------------------------------------------------------------------
_LEAST_OWN: Final = 1e-9  # a parameter that one group alone determines leaves nothing to predict it by
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
        return _triangular(self.nuisances.factor, self.nuisances.values.T)

    @cached_property
    def number(self) -> Array:
        """Return how many rows of each group count."""
        return np.bincount(self.group[self.counts], minlength=self.size).astype(np.float64)

    @cached_property
    def _position(self) -> NDArray[np.intp]:
        position = np.full(self.group.size, -1, dtype=np.intp)
        position[self.nuisances.rows] = np.arange(self.nuisances.rows.size)
        return position

    @cached_property
    def single(self) -> tuple[NDArray[np.intp], Array]:
        """Return groups of one row each (priors): their rows, and 1 − H for the nuisances."""
        rows = np.flatnonzero(self.counts & (self.number[self.group] == 1))
        at = self._position[rows]
        hat = np.where(at >= 0, np.sum(self._whitened[:, np.maximum(at, 0)] ** 2, axis=0), 0.0)
        return rows, np.maximum(1.0 - hat, _LEAST_OWN)

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
            factor = np.asarray(np.linalg.cholesky((1.0 + _LEAST_OWN) * np.eye(hat.shape[0]) - hat))
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
    half = _triangular(known.factor, known.pull(freed))
    pulled = _triangular(known.factor, half, transposed=True)
    freed[known.rows] -= known.values @ pulled
    values, vectors = np.linalg.eigh(freed.T @ freed)
    kept = values > _LEAST_OWN
    return np.asarray(freed @ (vectors[:, kept] / np.sqrt(values[kept])))


def _reduced(products: Array) -> tuple[float, float]:
    """Return (χ², ln determinant) after the effects, from their products and the residual's by (I − H_g)⁻¹."""
    count = products.shape[0] - 1
    values, vectors = np.linalg.eigh(np.eye(count) - products[:count, :count])
    values = np.maximum(values, _LEAST_OWN)
    pulled = vectors.T @ products[:count, count]
    return float(products[count, count] + np.sum(pulled**2 / values)), float(np.sum(np.log(values)))
