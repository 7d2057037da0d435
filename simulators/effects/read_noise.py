"""The noise of reading a pixel out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage, parameter
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class ReadNoise(KeepsMean):
    """Adds normal noise of constant size in electrons; the rounding of `quantisation` comes on top of it.

    Source: EMVA Standard 1288, release 4.0, equation (10).
    """

    name = "read_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    read_noise_e: float = parameter(2.5, "e-", 0.0, 1e4, source="datasheet, quantisation taken out")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        noise = rng.standard_normal(signal.shape, dtype=np.float32)
        noise *= np.float32(self.read_noise_e)
        noise += signal
        return noise

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        return self.read_noise_e**2
