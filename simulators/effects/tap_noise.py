"""Quarters of the sensor whose amplifiers have different read noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.quarters import by_quarter, trials


@dataclass(frozen=True)
class TapNoise(KeepsMean, CatalogueEffect):
    """Adds normal noise of σ² = max(0, m² + a·s_x + b·s_y + c·s_x·s_y), even within each quarter.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2: each output amplifier has its own noise.
    """

    name = "tap_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "image_x"
    block = "variance"
    log_prior_odds = -1.0
    prior_reason = "most sensors have one amplifier, or a converter per column"
    trials = tuple({"mean_e": 3.0, **start} for start in trials((8.0, -8.0), ("across_e2", "along_e2", "corner_e2")))
    fitted = ("mean_e", "across_e2", "along_e2", "corner_e2")
    essential = ()
    settles = "many frames of no exposure"
    mean_e: float = parameter(0.0, "e-", 0.0, 1000.0, source="engineering prior; refined on a real rig")
    across_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source="engineering prior; refined on a real rig")
    along_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source="engineering prior; refined on a real rig")
    corner_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source="engineering prior; refined on a real rig")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with the noise of each quarter."""
        sigma = np.sqrt(self.variance(signal, context))
        return cast(Signal, (signal + sigma * rng.standard_normal(signal.shape)).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Any:
        """Return σ² in e-²."""
        return np.maximum(self.mean_e**2 + by_quarter(context, self.across_e2, self.along_e2, self.corner_e2), 0.0)
