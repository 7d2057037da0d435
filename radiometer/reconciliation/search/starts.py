"""Picks the likeliest of many starts of one entry without running the whole chain for each.

An exposure quantum or a wrong label scales whole captures, a flickering source shakes whole frames, a wave runs along
the rows. The gain of thousands of starts follows from one small matrix, or from the exact likelihood of one statistic
alone. The entry itself gives its starts, and those between and around them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.measure.row_bands import RowBins, wave_power
from radiometer.reconciliation.noise.shared_errors import mixing_of_bands, relative_bands
from radiometer.typing import Array
from simulators.effects.base import DIGITAL_NUMBER
from simulators.effects.catalogue import CatalogueEffect, Offset, Scaling
from simulators.effects.tile_moments import TileMoments

Starts = tuple[CatalogueEffect, ...]
_MANY: Final = 20  # starts, beyond which the likeliest are picked first
_KEPT: Final = 8
_LARGEST_AMPLITUDE: Final = 300.0
_SIZES: Final = np.geomspace(0.01, 30.0, 25)  # times the size that starts have
_SCALES: Final = np.geomspace(1e-3, 1e1, 9)  # of a wave's variance, about the one that has all of what is seen
_REFINED: Final = 3  # waves of different spatial frequency that are searched about
_WORTH_IT: Final = 20.0  # deviance that the best of the coarse grid must bring before
_ROUNDS: Final = 2


class StartPool:
    """The starts of all entries for one capture set; they are made once."""

    def __init__(self) -> None:
        self._starts: dict[str, Starts] = {}
        self._between: dict[str, Starts] = {}
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
        if issubclass(kind, Scaling | Offset) and _goes_by_captures(state, starts[0]):
            return self._of_captures(state, starts)
        picks: Mapping[str, Callable[[FitState, Starts], Starts]] = {"common": self._of_frames, "bands": _of_bands}
        return picks[kind.block](state, starts) if kind.block in picks and kind.acts_by_square else starts

    def count(self, kind: type[CatalogueEffect]) -> int:
        """Return how many starts an entry has; 1 before they were asked for."""
        return len(self._starts.get(kind.name, (None,)))

    def _of_captures(self, state: FitState, starts: Starts) -> Starts:
        """Return the likeliest of those that scale whole captures, or add something to them."""
        moves = self._known(starts[0].name, lambda: np.stack([_of_each_capture(state, start) for start in starts]))
        unit = state.sensitivity if isinstance(starts[0], Scaling) else np.ones_like(state.sensitivity)
        gram, slope = _of_all_captures(state, unit)
        rise = moves @ slope
        curvature = np.einsum("sc,cd,sd->s", moves, gram, moves, optimize=True)
        free = bool(starts[0].free())  # what has no amplitude acts as it is or not at all
        amplitude = np.clip(rise / np.maximum(curvature, 1e-12), 0.0, _LARGEST_AMPLITUDE) if free else 1.0
        gain = amplitude * (2.0 * rise - amplitude * curvature)
        return tuple(starts[int(i)] for i in np.argsort(-gain)[:_KEPT])

    def _known(self, name: str, work: Callable[[], Array]) -> Array:
        if name not in self._moves:
            self._moves[name] = work()
        return self._moves[name]

    def _of_frames(self, state: FitState, starts: Starts) -> Starts:
        """Return the likeliest of what shakes whole frames, of each variant one at least, in their likeliest sizes."""
        name, context = starts[0].name, state.model.context
        if name not in self._between:
            self._between[name] = tuple(between for start in starts for between in start.between())
        dense, captures = self._between[name], len(state.design.captures)
        added = partial(_stacked, (start.common_variance(np.ones(()), context) for start in dense), captures)
        moves = self._known(name, added)
        here, rows = state.comparison.flicker_of(state.prediction), state.prediction.row_variance
        sizes = np.square(_SIZES)
        rated = [state.comparison.deviances_of_flicker(here + size * moves, rows).sum(axis=1) for size in sizes]
        best, least = np.argmin(rated, axis=0), np.min(rated, axis=0)
        order = [int(i) for i in np.argsort(least)]
        first = {_variant(dense[i]): i for i in reversed(order)}
        chosen = list(dict.fromkeys([*sorted(first.values(), key=lambda i: least[i]), *order]))[:_KEPT]
        return tuple(dense[i].resized(float(np.sqrt(sizes[best[i]]))) for i in chosen)


def _stacked(values: Any, captures: int) -> Array:
    return np.stack([np.broadcast_to(np.ravel(v), (captures,)) for v in values])


def _variant(start: CatalogueEffect) -> tuple[object, ...]:
    """Return what of a start is not fitted."""
    free = start.free()
    return tuple(value for name, value in start.values().items() if name not in free)


def _of_all_captures(state: FitState, unit: Array) -> tuple[Array, Array]:
    """Return the Gram matrix and the slope of χ² for changes of each capture's means, nuisances following.

    Args:
        state: The fitted model.
        unit: What a change of 1 moves of means in DN, (captures, tiles).
    """
    captures, tiles = unit.shape
    raw = np.zeros((captures, tiles, captures))
    index = np.arange(captures)
    raw[index, :, index] = unit
    moves = state.comparison.whiten("mean", raw).reshape(captures * tiles, captures)
    cut = state.comparison.cuts["mean"]
    part = state.fit.half(state.fit.pull(moves, cut.start))
    return moves.T @ moves - part.T @ part, moves.T @ state.fit.projected[cut]


def _goes_by_captures(state: FitState, start: CatalogueEffect) -> bool:
    """Return whether a start changes whole captures alike: in proportion, or by so many DN."""
    if isinstance(start, Scaling):
        return True
    if not isinstance(start, Offset) or start.unit_out != DIGITAL_NUMBER:
        return False
    return np.size(start.offset(state.model.context)) == len(state.design.captures)


def _of_each_capture(state: FitState, start: CatalogueEffect) -> Array:
    """Return by what share of its light, or by how many DN, a start changes each capture, (captures,)."""
    if isinstance(start, Scaling):
        change: Any = np.asarray(start.factor(state.model.context)) - 1.0
    elif isinstance(start, Offset):
        change = np.asarray(start.offset(state.model.context))
    else:
        raise TypeError(f"{start.name} is searched densely but is neither Scaling nor Offset")
    return np.asarray(np.broadcast_to(change.reshape(-1), (len(state.design.captures),)))


# ---- waves along the rows -------------------------------------------------------------------------------------


def _of_bands(state: FitState, starts: Starts) -> Starts:
    """Return the likeliest waves along the rows with their likeliest size, the best first.

    They are rated by the exact likelihood of the bands alone. A wave that stands out by far has its lobes over the
    exposures resolved: about the best of each spatial frequency the starts nearby are looked at.
    """
    rater = _WaveRater(state)
    ranked = sorted((rater.sized(start) for start in starts), key=lambda rated: rated.deviance)
    best: dict[float, _Rated] = {}
    for rated in ranked:
        best.setdefault(round(rated.per_row, 9), rated)
    found = list(best.values())[:_REFINED]
    if rater.nothing - found[0].deviance > _WORTH_IT:
        found = [rater.refined(rated) for rated in found]
    found = sorted([*found, *ranked[:_KEPT]], key=lambda rated: rated.deviance)
    return tuple(rated.wave for rated in found[:_KEPT])


@dataclass(frozen=True, slots=True)
class _Rated:
    """A wave at its likeliest size, a factor on its start's: the deviance of the bands, and its periods per row."""

    deviance: float
    start: CatalogueEffect
    size: float
    per_row: float

    @property
    def wave(self) -> CatalogueEffect:
        """Return the wave of that size."""
        return self.start.resized(self.size)


class _WaveRater:
    """Rates waves by the bands that count, (entries,), of the captures that have any."""

    def __init__(self, state: FitState) -> None:
        comparison, prediction, seen = state.comparison, state.prediction, state.comparison.seen
        here = comparison.band_power(relative_bands(prediction), prediction.band_frequency)
        mixed = mixing_of_bands(prediction, state.design) if prediction.mixed_x.any() else 0.0
        mask = comparison.usable["bands"]
        self._captures = mask.any(axis=1)
        self._there = np.nonzero(mask[self._captures])
        self._steady = (1.0 + prediction.row_variance[:, None] * seen.bands_of_rows + here + mixed)[mask]
        self._seen, self._dof = seen.bands[mask], np.broadcast_to(comparison.band_freedom, mask.shape)[mask]
        self._more = float(np.sum(np.maximum(self._seen - self._steady, 0.0)))
        self._bins, self._basis = RowBins.of(state.design), seen.bands_basis[self._captures]
        self._context, self._rows = state.model.context, state.design.shape[0]
        self._one = TileMoments.exactly(np.ones((self._captures.size, 1, 1)))
        self._waves: dict[float, Array] = {}
        self.nothing = float(self._deviances(self._steady))

    def sized(self, start: CatalogueEffect) -> _Rated:
        """Return a wave of the size that has the least deviance."""
        after = start.tile(self._one, self._one, self._context)
        per_row = after.band_frequency
        if per_row not in self._waves:
            self._waves[per_row] = wave_power(self._bins, self._basis, per_row)[0][self._there]
        variance = np.broadcast_to(after.band_variance, (self._captures.size, 1, 1))[self._captures, 0, 0]
        added = variance[self._there[0]] * self._waves[per_row]
        scales = _SCALES * self._more / max(float(np.sum(added)), 1e-30)
        deviances = self._deviances(self._steady + scales[:, None] * added)
        best = int(np.argmin(deviances))
        return _Rated(float(deviances[best]), start, float(np.sqrt(scales[best])), per_row)

    def refined(self, rated: _Rated) -> _Rated:
        """Return the likeliest wave about one: each turn of what the entry calls nearby, twice."""
        for turn in (0, 1) * _ROUNDS:
            nearby = (self.sized(start) for start in rated.wave.nearby(self._rows, turn))
            rated = min((rated, *nearby), key=lambda entry: entry.deviance)
        return rated

    def _deviances(self, expected: Array) -> Array:
        """Return −2·ln of the likelihood under expected ratios, (…, entries), but for a constant."""
        return np.asarray(np.sum(self._dof * (self._seen / expected + np.log(expected)), axis=-1))
