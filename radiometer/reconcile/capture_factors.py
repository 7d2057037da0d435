"""Judges thousands of ways to scale whole captures at once: the dense search for an exposure quantum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from radiometer.reconcile.design import Array
from radiometer.reconcile.state import FitState
from simulators.effects.catalogue import CatalogueEffect, Scaling


def best_by_capture_factor(
    state: FitState, starts: Sequence[CatalogueEffect], count: int
) -> tuple[CatalogueEffect, ...]:
    """Return the starts whose factors per capture explain most of the means.

    A factor f on the light of capture c moves its means by s·(f − 1). With the Gram matrix of these moves, freed of
    the nuisances, the gain of any set of factors is a quadratic form of the size of the number of captures.

    Args:
        state: The fitted model.
        starts: Effects whose factor is one number per capture.
        count: How many to return.
    """
    moves = _moves(state)
    cut = state.comparison.cuts["mean"]
    fit = state.fit
    part = fit.half(fit.jacobian[cut].T @ moves)
    gram = moves.T @ moves - part.T @ part
    slope = moves.T @ fit.projected[cut]
    factors = np.stack([_factor(state, start) for start in starts])
    gain = 2.0 * (factors - 1.0) @ slope - np.einsum("sc,cd,sd->s", factors - 1.0, gram, factors - 1.0, optimize=True)
    return tuple(starts[int(i)] for i in np.argsort(-gain)[:count])


def _moves(state: FitState) -> Array:
    """Return the whitened change of all means per unit factor of each capture, (entries, captures)."""
    captures, tiles = state.sensitivity.shape
    raw = np.zeros((captures, tiles, captures))
    index = np.arange(captures)
    raw[index, :, index] = state.sensitivity
    return state.comparison.whiten("mean", raw).reshape(captures * tiles, captures)


def _factor(state: FitState, start: CatalogueEffect) -> Array:
    if not isinstance(start, Scaling):
        raise TypeError(f"{start.name} is searched densely but is no Scaling")
    factor: Any = start.factor(state.model.context)
    captures = len(state.design.captures)
    return np.asarray(np.broadcast_to(np.asarray(factor).reshape(-1), (captures,)))
