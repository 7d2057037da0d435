"""The grain of light and of dark current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class ShotNoise(KeepsMean):
    """Draws the number of electrons from a Poisson distribution of the expected number; exact, not approximated.

    Source: EMVA Standard 1288, release 4.0, equation (9).
    """

    name = "shot_noise"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        return rng.poisson(signal).astype(signal.dtype)

    def variance(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the expected number: a Poisson count's variance is its mean."""
        return np.maximum(signal, 0.0)
