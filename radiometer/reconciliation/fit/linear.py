"""Least squares on the whitened vector, linearised: projection and score tests.

The nuisances touch few of the statistics (the means, mostly), the effects any: their columns are kept apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtrs

from radiometer.typing import Array

_ITERATIONS: Final = 25
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
            other: The other block, of the same rows.
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
        known, border = self.nuisances.columns, triangular(self.nuisances.factor, self._pulled[:, 1:])
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
        """Return Jᵀ·residual."""
        return np.concatenate([self._pulled[:, 0], self.effects.T @ self.residual])

    def step_from(self, residual: Array) -> tuple[Array, float]:
        """Return the same step from another point's residual, followers not followed yet, and what χ² it promises."""
        return self._step_of(self.followed(residual))

    def left_from(self, residual: Array) -> float:
        """Return the χ² that such a step promises to leave."""
        followed = self.followed(residual)
        return float(followed @ followed) - self._step_of(followed)[1]

    def _step_of(self, followed: Array) -> tuple[Array, float]:
        pulled = self.pull(followed)
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
        """Return `followed(vectors)` and Nᵀ of it."""
        pulled = self.nuisances.pull(vectors)
        if not self.followers.rows.size:
            return vectors.copy(), pulled
        half = triangular(self.nuisances.factor, pulled)
        led = triangular(self.nuisances.factor, half, transposed=True)[: self.followers.columns]
        moved = vectors.copy()
        moved[self.followers.rows] -= self.followers.values @ led
        return moved, pulled - self._crossed @ led

    @cached_property
    def _crossed(self) -> Array:
        """Return Nᵀ·F."""
        _, own, theirs = np.intersect1d(
            self.nuisances.rows, self.followers.rows, assume_unique=True, return_indices=True
        )
        return np.asarray(self.nuisances.values[own].T @ self.followers.values[theirs])

    def solve(self, right: Array) -> Array:
        """Return (JᵀJ)⁻¹ · right."""
        return triangular(self.factor, self.half(right), transposed=True)

    def half(self, right: Array) -> Array:
        """Return L⁻¹ · right for JᵀJ = L·Lᵀ."""
        return triangular(self.factor, right)

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


def triangular(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    """Return L⁻¹·right or L⁻ᵀ·right for a lower Cholesky factor; LAPACK's own, for most systems are small.

    Raises:
        numpy.linalg.LinAlgError: If the factor is singular.
    """
    if not right.size:
        return np.zeros(right.shape)
    # LAPACK reads columns first: our rows are the transpose to it, the upper factor Lᵀ.
    found, singular = dtrtrs(factor.T, right, lower=0, trans=0 if transposed else 1)
    if singular:
        raise np.linalg.LinAlgError(f"row {singular} of a Cholesky factor is nothing")
    return np.asarray(found)


class _Point(Protocol):
    @property
    def cost(self) -> float: ...


_PointT = TypeVar("_PointT", bound=_Point)


def descended(
    point: _PointT,
    trials: Callable[[_PointT], Iterable[_PointT]],
    enough: Callable[[_PointT], float],
    iterations: int = _ITERATIONS,
) -> _PointT:
    """Return the point of least χ² by damped Gauss–Newton steps: of each point's trials the first lower one is taken.

    Args:
        point: Where to start.
        trials: Gives what to try from a point, each more damped than the one before.
        enough: Gives the gain of χ² below which a point is the last.
        iterations: How many steps at most.
    """
    for _ in range(iterations):
        lower = next((trial for trial in trials(point) if trial.cost < point.cost), None)
        if lower is None:
            break
        gained, point = point.cost - lower.cost, lower
        if gained < enough(point):
            break
    return point
