"""Computes how a model responds to a little more light or warmth, and to each of its effects."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.model.tile_model import TileModel, Trace
from radiometer.reconciliation.noise.darkness import Darkness, drift_of_black, wander_of_black
from radiometer.reconciliation.statistics import STATISTICS, Scale
from radiometer.typing import Array

_SENSITIVITY_STEP: Final = 1e-3
_WARMER_K: Final = 0.1
_STEEPEST_DOUBLING_K: Final = 4.0  # of a dark current in silicon
_SWELLING: Final = ("variance", "spatial")  # what leaks and their shot noise add to
_FORM_FLOOR: Final = 0.005  # share of an accepted effect's own correction that its form is not trusted with


def light_response(model: TileModel, here: Trace) -> tuple[Array, Array]:
    """Return d(mean)/d(log light) in DN and |d(ln variance)/d(log light)| by a finite difference."""
    nuisance, base = here.nuisance, here.prediction
    more = nuisance.with_off(log_responsivity=nuisance.off.log_responsivity + _SENSITIVITY_STEP)
    moved = model.predict(more, here)
    mean = (moved.mean - base.mean) / _SENSITIVITY_STEP
    variance = np.abs(np.log(moved.variance / base.variance)) / _SENSITIVITY_STEP
    return np.asarray(mean), np.asarray(variance)


def darkness_of(model: TileModel, here: Trace, seen: CaptureStatistics) -> Darkness | None:
    """Return how far darkness differs from frame to frame; None where nothing shows that it does."""
    design, base = model.design, here.prediction
    black_dn, drift_dn, reading_k = wander_of_black(design, seen), drift_of_black(design, seen), design.reading_u_k
    if not (black_dn or drift_dn or reading_k):
        return None
    warmer = model.warmed(_WARMER_K).predict(here.nuisance) if reading_k else base
    # A law that is not found yet may rise steeply: no more than what was seen to gather can.
    most = np.log(2.0) / _STEEPEST_DOUBLING_K * np.maximum(seen.mean - np.nanmin(seen.mean), 0.0)
    swelling = {n: np.log(getattr(warmer, n) / getattr(base, n)) / _WARMER_K for n in _SWELLING} if reading_k else {}
    warmth = np.clip((warmer.mean - base.mean) / _WARMER_K, -most, most)
    return Darkness(black_dn, reading_k, warmth, swelling, drift_dn)


def form_floors(model: TileModel, here: Trace) -> dict[str, Array]:
    """Return by statistic the uncertainty of the accepted effects' form: a share of each one's own correction."""
    floors: dict[str, Array] = {}
    everything = (*model.given, *model.effects)
    for index in range(len(everything)):
        without = tuple(effect for i, effect in enumerate(everything) if i != index)
        other = replace(model, given=(), effects=without).predict(here.nuisance, here)
        for name, row in STATISTICS.items():
            if row.holds_form:
                there, bare = getattr(here.prediction, name), getattr(other, name)
                change = np.log(there / bare) if row.scale is Scale.LOGARITHM else there - bare
                floors[name] = np.hypot(floors.get(name, 0.0), _FORM_FLOOR * np.abs(change))
    return floors
