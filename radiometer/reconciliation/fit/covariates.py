"""The axes along which measured and predicted are compared, and smooth bases on them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.polynomial import legendre

from radiometer.reconciliation.chances import ranks
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.model.tile_model import TileModel
from radiometer.reconciliation.statistics import Prediction
from radiometer.typing import Array

DEGREE: Final = 4
_MOST_LEVELS: Final = 8  # a covariate with fewer distinct values is treated level by level
_FEWEST_PER_WAVE: Final = 6  # captures
_MOST_WAVES: Final = 16
_LEVELLED: Final = ("gain_db", "f_number", "source_level", "pattern")


@dataclass(frozen=True, slots=True, eq=False)
class Covariate:
    """One axis: a value per capture and tile."""

    name: str  # name as in result files
    value: Array  # (captures, tiles)
    per_capture: bool  # whether all tiles of a capture share it
    waves: int = 0  # number of half waves that its basis holds in place of low polynomials; 0 for those

    def basis(self) -> Array:
        """Return smooth functions of the covariate, (captures, tiles, terms), the constant left out."""
        flat = self.value.ravel()
        levels = np.unique(np.round(flat, 9))
        if levels.size < 2:
            return np.zeros((*self.value.shape, 0))
        if self.waves:
            half_turns = np.pi * 0.5 * (_linear_axis(flat) + 1.0)
            columns = [np.cos(k * half_turns) for k in range(1, self.waves + 1)]
            return np.stack(columns, axis=-1).reshape(*self.value.shape, -1)
        if levels.size <= _MOST_LEVELS or (self.name in _LEVELLED and levels.size <= 2 * _MOST_LEVELS):
            columns = [(np.abs(flat - level) < 1e-8).astype(np.float64) for level in levels[1:]]
            return np.stack(columns, axis=-1).reshape(*self.value.shape, -1)
        u = 0.5 * (_rank_axis(flat) + _linear_axis(flat))
        columns = [np.asarray(legendre.legval(u, np.eye(DEGREE + 1)[k])) for k in range(1, DEGREE + 1)]
        return np.stack(columns, axis=-1).reshape(*self.value.shape, -1)


def _rank_axis(values: Array) -> Array:
    rank = ranks(np.round(values, 9))  # repeats differ in their last bits
    return np.asarray(2.0 * (rank - rank.min()) / max(np.ptp(rank), 1e-30) - 1.0)


def _linear_axis(values: Array) -> Array:
    return np.asarray(2.0 * (values - values.min()) / max(np.ptp(values), 1e-30) - 1.0)


def covariates(model: TileModel, prediction: Prediction) -> dict[str, Covariate]:
    """Return all covariates that vary within a capture set, by name."""
    design = model.design
    found = {}
    for covariate in (*_of_captures(design, prediction), *_of_tiles(model), _signal(prediction)):
        if np.isfinite(covariate.value).all() and np.ptp(covariate.value) > 1e-9:
            found[covariate.name] = covariate
    return found


def _of_captures(design: Design, prediction: Prediction) -> list[Covariate]:
    ones = np.ones((1, len(design.tiles)))

    def wide(name: str, values: Array) -> Covariate:
        return Covariate(name, values[:, None] * ones, per_capture=True)

    warm = design.temperature_c
    order = np.argsort([capture.frames[0] for capture in design.captures])
    level = np.log10(1.0 + prediction.signal.mean(axis=1))
    before = np.zeros_like(level)
    before[order[1:]] = level[order[:-1]]
    waves = min(_MOST_WAVES, len(design.captures) // _FEWEST_PER_WAVE)
    return [
        wide("exposure_s", np.log10(design.exposure_s)),
        wide("gain_db", design.gain_db),
        wide("f_number", np.log2(design.f_number)),
        wide("temperature_C", warm if np.isfinite(warm).all() else np.zeros_like(level)),
        wide("source_level", design.source_level),
        wide("timestamp_s", design.timestamp_s),
        wide("pattern", np.where(design.closed, 0, design.pattern_index).astype(np.float64)),
        wide("previous_frame", before),
        *([replace(wide("time_waves", design.timestamp_s), waves=waves)] if waves > DEGREE else []),
    ]


def _of_tiles(model: TileModel) -> list[Covariate]:
    design = model.design
    ones = np.ones((len(design.captures), 1))
    geometry = model.context.geometry
    x, y = geometry.x_px.mean(axis=-1), geometry.y_px.mean(axis=-1)
    radius = geometry.field_radius().mean(axis=-1)
    patch = np.log10(np.maximum(model.radiance, 1e-30))[design.pattern_index]
    lit = np.where(design.closed[:, None], patch.mean(), patch)
    return [
        Covariate("patch_level", lit, per_capture=False),
        Covariate("field_radius", radius * ones, per_capture=False),
        Covariate("image_x", x * ones, per_capture=False),
        Covariate("image_y", y * ones, per_capture=False),
        Covariate("half_x", (x > design.shape[1] / 2.0) * ones, per_capture=False),
        Covariate("half_y", (y > design.shape[0] / 2.0) * ones, per_capture=False),
    ]


def _signal(prediction: Prediction) -> Covariate:
    return Covariate("signal", np.log10(10.0 + np.maximum(prediction.signal, 0.0)), per_capture=False)
