"""How far the form of an accepted effect is trusted."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.model.tile_model import Nuisance, Prediction, TileModel

_FORM_FLOOR: Final = 0.005  # share of an accepted effect's own correction that its form is not trusted with


def form_floors(model: TileModel, nuisance: Nuisance, prediction: Prediction) -> dict[str, Array]:
    """Return per block the uncertainty of the accepted effects' form: a share of each one's own correction."""
    floors: dict[str, Array] = {}
    everything = (*model.given, *model.effects)
    for index in range(len(everything)):
        without = tuple(effect for i, effect in enumerate(everything) if i != index)
        other = replace(model, given=(), effects=without).predict(nuisance)
        for name, change in _corrections(prediction, other).items():
            floors[name] = np.hypot(floors.get(name, 0.0), _FORM_FLOOR * change)
    return floors


def _corrections(with_it: Prediction, without: Prediction) -> dict[str, Array]:
    plain = ("mean", "slope_x", "slope_y", "neighbour_x", "neighbour_y", "first", "edge")
    found = {name: np.abs(getattr(with_it, name) - getattr(without, name)) for name in plain}
    for name in ("variance", "spatial"):
        found[name] = np.abs(np.log(getattr(with_it, name) / getattr(without, name)))
    return found
