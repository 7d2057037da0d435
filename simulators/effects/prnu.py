"""Pixels that differ in their response to light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class Prnu(KeepsMean, CatalogueEffect):
    """Scales each pixel by a fixed factor, normal about 1 with standard deviation p.

    Source: EMVA Standard 1288, release 4.0, PRNU1288; typical 0.3 to 1 %.
    """

    name = "prnu"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "dark_current"
    where = "signal"
    block = "spatial"
    acts_by_square = True
    trials = ({"sigma_rel": 0.005}, {"sigma_rel": 0.02})
    fitted = ("sigma_rel",)
    settles = "an average of many bright frames of an even field"
    sigma_rel: float = parameter(0.0, "1", 0.0, 0.5, source=PRIOR)

    proportional: ClassVar[bool] = True  # the pattern grows with the light

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        pattern = context.fixed_rng(self.name).standard_normal(signal.shape, dtype=np.float32)
        return cast(Signal, signal * np.maximum(1.0 + self.sigma_rel * pattern, 0.0))

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, np.square(self.sigma_rel * signal))
