"""Picks the likeliest of many waves along the rows, by the exact likelihood of the bands alone.

A wave that stands out by far has its lobes over the exposures resolved: about the best of a coarse grid its spatial
frequency and then its frequency are searched in steps that no lobe slips through.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.noise.row_scatter import mixing_of_bands
from radiometer.reconcile.noise.scatter import relative_bands
from radiometer.reconcile.noise.variance_scores import deviances
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from simulators.effects.tile_moments import TileMoments

_SCALES: Final = np.geomspace(1e-3, 1e1, 9)  # of a wave's variance, about the one that has all of what is seen
_REFINED: Final = 3  # waves of different spatial frequency that are searched about
_WORTH_IT: Final = 20.0  # deviance that the best of the coarse grid must bring before
_ROUNDS: Final = 2
_SHIFTS: Final = np.linspace(-0.5, 0.5, 21)  # periods per frame
_STEP_HZ: Final = 20.0
_RANGE_HZ: Final = (60.0, 4500.0)


def likeliest_bands(
    state: FitState, starts: Sequence[RollingShutterBanding], most: int
) -> tuple[RollingShutterBanding, ...]:
    """Return the likeliest waves along the rows with their likeliest size, the best first.

    Args:
        state: The fitted model.
        starts: Waves to try; at least one.
        most: How many to return.
    """
    scorer = _Scorer(state)
    ranked = sorted((scorer.sized(start) for start in starts), key=lambda rated: rated[0])
    best: dict[float, tuple[float, RollingShutterBanding]] = {}
    for rated in ranked:
        best.setdefault(round(rated[1].frequency_hz * rated[1].row_time_s, 9), rated)
    found = list(best.values())[:_REFINED]
    if scorer.nothing - found[0][0] > _WORTH_IT:
        found = [_refined(scorer, *rated) for rated in found]
    found = sorted([*found, *ranked[:most]], key=lambda rated: rated[0])
    return tuple(start for _, start in found[:most])


class _Scorer:
    def __init__(self, state: FitState) -> None:
        self._comparison, self._context = state.comparison, state.model.context
        self._captures, self.height = len(state.design.captures), state.design.shape[0]
        prediction, seen = state.prediction, state.comparison.seen
        here = self._comparison.band_power(relative_bands(prediction), prediction.band_frequency)
        mixed = mixing_of_bands(prediction, state.design) if prediction.mixed_x.any() else 0.0
        self._steady = 1.0 + prediction.row_variance[:, None] * seen.bands_of_rows + here + mixed
        self._mask = self._comparison.usable["bands"]
        self._more = float(np.sum(np.where(self._mask, np.maximum(seen.bands - self._steady, 0.0), 0.0)))
        self._waves: dict[float, Array] = {}
        self.nothing = self._deviance(self._steady)

    def sized(self, start: RollingShutterBanding) -> tuple[float, RollingShutterBanding]:
        """Return the least deviance of a wave over its size, and the wave of that size."""
        one = TileMoments.exactly(np.ones((self._captures, 1, 1)))
        after = start.tile(one, one, self._context)
        if after.band_frequency not in self._waves:
            ones = np.ones(self._captures)
            self._waves[after.band_frequency] = self._comparison.band_power(ones, after.band_frequency)
        variance = np.broadcast_to(after.band_variance, (self._captures, 1, 1))[:, :, 0]
        added = variance * self._waves[after.band_frequency]
        whole = self._more / max(float(np.sum(np.where(self._mask, added, 0.0))), 1e-30)
        rated = [(self._deviance(self._steady + scale * whole * added), scale * whole) for scale in _SCALES.tolist()]
        least, scale = min(rated)
        bound = next(entry for entry in start.parameters() if entry.name == "modulation").high
        return least, start.with_parameters(modulation=min(start.modulation * float(np.sqrt(scale)), bound))

    def _deviance(self, expected: Array) -> float:
        comparison = self._comparison
        return float(np.sum(deviances(comparison.seen.bands, expected, comparison.band_freedom, self._mask)))


def _refined(scorer: _Scorer, least: float, wave: RollingShutterBanding) -> tuple[float, RollingShutterBanding]:
    """Return the likeliest wave about one: along the spatial frequency, then along the frequency, twice."""
    for _ in range(_ROUNDS):
        per_row = wave.frequency_hz * wave.row_time_s
        others = [(wave.frequency_hz, per_row + shift / scorer.height) for shift in _SHIFTS.tolist()]
        least, wave = _best(scorer, least, wave, others)
        per_row = wave.frequency_hz * wave.row_time_s
        others = [(hertz, per_row) for hertz in np.arange(*_RANGE_HZ, _STEP_HZ).tolist()]
        least, wave = _best(scorer, least, wave, others)
    return least, wave


def _best(
    scorer: _Scorer, least: float, wave: RollingShutterBanding, others: Sequence[tuple[float, float]]
) -> tuple[float, RollingShutterBanding]:
    for hertz, per_row in others:
        low, high = next((e.low, e.high) for e in wave.parameters() if e.name == "row_time_s")
        if low <= per_row / hertz <= high:
            tried = scorer.sized(wave.with_parameters(frequency_hz=hertz, row_time_s=per_row / hertz))
            if tried[0] < least:
                least, wave = tried
    return least, wave
