"""Picks the likeliest of many starts of one entry without running the whole chain for each.

An exposure quantum or a wrong label scales whole captures, a flickering source shakes whole frames: what thousands of
starts would explain follows from one small matrix.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from radiometer.reconcile.band_starts import likeliest_bands
from radiometer.reconcile.design import Array
from radiometer.reconcile.state import FitState
from simulators.effects.catalogue import CatalogueEffect, Scaling
from simulators.effects.rolling_shutter_banding import RollingShutterBanding

Starts = tuple[CatalogueEffect, ...]
_MANY: Final = 20  # starts, beyond which the likeliest are picked first
_KEPT: Final = 8
_LARGEST_AMPLITUDE: Final = 300.0


class StartPool:
    """The starts of all entries for one capture set; they are made once."""

    def __init__(self) -> None:
        self._starts: dict[str, Starts] = {}
        self._moves: dict[str, Array] = {}

    def likeliest(self, state: FitState, kind: type[CatalogueEffect]) -> Starts:
        """Return the starts of an entry; of many only those that explain most at first sight.

        Args:
            state: The fitted model.
            kind: The entry.
        """
        if kind.name not in self._starts:
            self._starts[kind.name] = kind.starts(state.model.context)
        starts = self._starts[kind.name]
        if len(starts) <= _MANY:
            return starts
        if issubclass(kind, Scaling):
            return self._best(state, starts, self._factors(state, starts) - 1.0, *_of_captures(state))
        if kind.block == "common":
            return self._best_flicker(state, starts)
        waves = [start for start in starts if isinstance(start, RollingShutterBanding)]
        if waves:
            return likeliest_bands(state, waves, _KEPT)
        return starts

    def count(self, kind: type[CatalogueEffect]) -> int:
        """Return how many starts an entry has; 1 before they were asked for."""
        return len(self._starts.get(kind.name, (None,)))

    def _best(self, state: FitState, starts: Starts, moves: Array, gram: Array, slope: Array) -> Starts:
        rise = moves @ slope
        curvature = np.einsum("sc,cd,sd->s", moves, gram, moves, optimize=True)
        free = bool(starts[0].free())  # what has no amplitude acts as it is or not at all
        amplitude = np.clip(rise / np.maximum(curvature, 1e-12), 0.0, _LARGEST_AMPLITUDE) if free else 1.0
        gain = amplitude * (2.0 * rise - amplitude * curvature)
        return tuple(starts[int(i)] for i in np.argsort(-gain)[:_KEPT])

    def _factors(self, state: FitState, starts: Starts) -> Array:
        name = starts[0].name
        if name not in self._moves:
            self._moves[name] = np.stack([_factor(state, start) for start in starts])
        return self._moves[name]

    def _best_flicker(self, state: FitState, starts: Starts) -> Starts:
        name, captures = starts[0].name, len(state.design.captures)
        if name not in self._moves:
            one = np.ones((captures, 1, 1))
            added = [np.asarray(start.common_variance(one, state.model.context)) for start in starts]
            self._moves[name] = np.stack([np.broadcast_to(v.reshape(-1), (captures,)) for v in added])
        here = state.comparison.flicker_of(state.prediction)
        rows = state.prediction.row_variance
        base = state.comparison.common_scores(here, rows)
        moves = np.stack([base - state.comparison.common_scores(here + added, rows) for added in self._moves[name]])
        cut = state.comparison.cuts["common"]
        return self._best(state, starts, moves, np.eye(captures), state.fit.projected[cut])


def _of_captures(state: FitState) -> tuple[Array, Array]:
    """Return the Gram matrix and the slope of χ² for factors on the light of each capture, nuisances following.

    A factor f on the light of capture c moves its means by s·(f − 1).
    """
    moves = _moves(state)
    cut = state.comparison.cuts["mean"]
    part = state.fit.half(state.fit.pull(moves, cut.start))
    return moves.T @ moves - part.T @ part, moves.T @ state.fit.projected[cut]


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
