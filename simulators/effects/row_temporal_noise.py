"""Noise that the pixels of a row share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class RowTemporalNoise(KeepsMean, CatalogueEffect):
    """Adds a new random offset to each row of each frame, normal with standard deviation s.

    Source: a ramp or reference common to a row of a CMOS sensor; typical 0.1 to 1 e-.
    """

    name = "row_temporal_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "image_y"
    block = "row_temporal"
    acts_by_square = True
    trials = ({"sigma_e": 0.3}, {"sigma_e": 1.0})
    fitted = ("sigma_e",)
    settles = "many dark frames at the highest gain"
    sigma_e: float = parameter(0.0, "e-", 0.0, 1000.0, source=PRIOR)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        rows = rng.standard_normal((signal.shape[0], 1), dtype=np.float32)
        return cast(Signal, signal + self.sigma_e * rows)

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        return self.sigma_e**2

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        return after.changed(variance=before.variance, row_variance=before.row_variance + self.sigma_e**2)
