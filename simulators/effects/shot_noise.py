"""The grain of light and of dark current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


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
        return np.maximum(signal, 0.0)

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the noise that its mean light gives a tile also where it is so steep that points are below zero."""
        if np.min(before.mean) >= 0.0:
            return after
        own = self.variance(before.mean, context)
        light = np.maximum(before.mean.mean(axis=-1, keepdims=True), 0.0)
        too_much = 1.0 - light / np.maximum(own.mean(axis=-1, keepdims=True), 1e-30)
        return after.changed(variance=after.variance - own * too_much)
