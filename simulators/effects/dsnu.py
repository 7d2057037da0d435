"""Dark signals that differ from pixel to pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class Dsnu(CatalogueEffect):
    """Adds a fixed offset to each pixel, normal with standard deviation s.

    Source: EMVA Standard 1288, release 4.0, DSNU1288; typical 0.5 to 3 e-.
    """

    name = "dsnu"
    stage = Stage.READOUT
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    where = "gain_db"
    block = "spatial"
    acts_by_square = True
    trials = (
        {"sigma_e": 0.5},
        {"sigma_e": 2.0},
    )
    fitted = ("sigma_e",)
    settles = "an average of many dark frames at the shortest exposure"
    sigma_e: float = parameter(0.0, "e-", 0.0, 1000.0, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the signal unchanged: the pattern averages to zero."""
        return signal

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with this camera's offsets."""
        pattern = context.fixed_rng(self.name).standard_normal(signal.shape, dtype=np.float32)
        return cast(Signal, signal + self.sigma_e * pattern)

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> float:
        """Return s² in e-²."""
        return self.sigma_e**2
