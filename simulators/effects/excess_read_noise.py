"""More read noise than the datasheet says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class ExcessReadNoise(KeepsMean, CatalogueEffect):
    """Adds normal noise: σ² grows by s².

    Source: EMVA Standard 1288, release 4.0, equation (10).
    """

    name = "excess_read_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "gain_db"
    block = "variance"
    acts_by_square = True
    trials = ({"excess_e": 1.0}, {"excess_e": 4.0})
    fitted = ("excess_e",)
    settles = "dark frames at the lowest and highest gain"
    excess_e: float = parameter(0.0, "e-", 0.0, 1000.0, source=PRIOR)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        return cast(Signal, signal + self.excess_e * rng.standard_normal(signal.shape, dtype=np.float32))

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        return self.excess_e**2
