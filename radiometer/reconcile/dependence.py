"""What blocks that are weighted apart have in common, and what that adds to the parameters' covariance.

The fit weights each block by itself. Where two of them see the same chance (the noise that the rows of a few frames
happened to have), their information does not add up: with X the covariance between the blocks that the weights leave
out, the estimate A⁻¹·Jᵀ·r has the covariance A⁻¹ + A⁻¹·Jᵀ·X·J·A⁻¹.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from radiometer.reconcile.design import Array
from radiometer.reconcile.row_scatter import shared_columns

if TYPE_CHECKING:
    from radiometer.reconcile.state import FitState


def effect_covariance(state: FitState) -> Array:
    """Return the covariance of the free effect parameters in units of their scales, what blocks share included."""
    first = state.layout.size + state.weights.size
    covariance = state.fit.covariance[first:, first:]
    families = shared_columns(state.comparison, state.prediction)
    if not (families and covariance.size):
        return covariance
    pulls = _pulls(state, first)
    for columns in families:
        parts = []
        for name, values in columns.items():
            own = pulls[state.comparison.cuts[name]].reshape(len(values), -1, covariance.shape[0])
            parts.append(np.matmul(own.transpose(0, 2, 1), values.reshape(len(values), own.shape[1], -1)))
        together = np.sum(parts, axis=0)
        covariance = covariance + np.einsum("cpr,cqr->pq", together, together)
        covariance = covariance - sum(np.einsum("cpr,cqr->pq", part, part) for part in parts)
    return covariance


def _pulls(state: FitState, first: int) -> Array:
    """Return by how much each entry of the residual moves each free effect parameter, (entries, parameters)."""
    fit = state.fit
    count = fit.effects.shape[1]
    unit = np.zeros((first + count, count))
    unit[first:] = np.eye(count)
    solved = fit.solve(unit)
    pulls = fit.effects @ solved[first:]
    pulls[fit.nuisances.rows] += fit.nuisances.values @ solved[:first]
    return np.asarray(pulls)
