"""Picks the likeliest of many starts of one entry without running the whole chain for each.

An exposure quantum or a wrong label scales whole captures, a flickering source shakes whole frames: what thousands of
starts would explain follows from one small matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.search.band_starts import likeliest_bands
from simulators.effects.catalogue import CatalogueEffect, Scaling
from simulators.effects.pwm_flicker import PwmFlicker
from simulators.effects.rolling_shutter_banding import RollingShutterBanding

Starts = tuple[CatalogueEffect, ...]
_MANY: Final = 20  # starts, beyond which the likeliest are picked first
_KEPT: Final = 8
_LARGEST_AMPLITUDE: Final = 300.0
_COMB: Final = np.geomspace(0.94, 1.06, 9)  # between one start's frequency and the next
_SIZES: Final = np.geomspace(0.01, 30.0, 25)  # times the modulation that starts have


class StartPool:
    """The starts of all entries for one capture set; they are made once."""

    def __init__(self) -> None:
        self._starts: dict[str, Starts] = {}
        self._moves: dict[str, Array] = {}
        self._combs: list[PwmFlicker] = []

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
        flickers = [start for start in starts if isinstance(start, PwmFlicker)]
        if flickers:
            return self._likeliest_flicker(state, flickers)
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

    def _likeliest_flicker(self, state: FitState, starts: Sequence[PwmFlicker]) -> Starts:
        """Return the likeliest flickers, of each duty one at least, in their likeliest sizes.

        Over many periods the light that an exposure leaves hangs on the frequency to a small part of a period, so that
        a dense comb of frequencies about each start is looked at.
        """
        name, context = starts[0].name, state.model.context
        if name not in self._moves:
            self._combs = [
                start.with_parameters(frequency_hz=float(start.frequency_hz * factor))
                for start in starts
                for factor in _COMB
            ]
            added = [comb.common_variance(np.ones(()), context) for comb in self._combs]
            captures = len(state.design.captures)
            self._moves[name] = np.stack([np.broadcast_to(np.ravel(v), (captures,)) for v in added])
        here, rows = state.comparison.flicker_of(state.prediction), state.prediction.row_variance
        sizes = np.square(_SIZES)
        rated = [
            state.comparison.deviances_of_flicker(here + size * self._moves[name], rows).sum(axis=1) for size in sizes
        ]
        best, least = np.argmin(rated, axis=0), np.min(rated, axis=0)
        order = [int(i) for i in np.argsort(least)]
        first = {self._combs[i].duty: i for i in reversed(order)}
        chosen = list(dict.fromkeys([*sorted(first.values(), key=lambda i: least[i]), *order]))[:_KEPT]
        return tuple(
            self._combs[i].with_parameters(modulation=self._combs[i].modulation * float(np.sqrt(sizes[best[i]])))
            for i in chosen
        )


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
