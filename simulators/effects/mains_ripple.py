"""A source that flickers with the mains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.flicker import flicker_sample, flicker_variance


@dataclass(frozen=True)
class MainsRipple(CatalogueEffect):
    """Modulates light at twice the mains frequency: L' = L·(1 + m·sin(2π·f·t + φ)), φ new in every frame.

    Zero for exposures of whole periods (10 ms at 100 Hz, 8.33 ms at 120 Hz).

    Source: rectified mains, 100 or 120 Hz.
    """

    name = "mains_ripple"
    stage = Stage.SOURCE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "exposure_s"
    block = "common"
    acts_by_square = True
    trials = (
        {"modulation": 0.02, "frequency_hz": 100.0},
        {"modulation": 0.02, "frequency_hz": 120.0},
    )
    fitted = ("modulation",)
    settles = "exposures of 9, 10 and 11 ms"
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source="engineering prior; refined on a real rig")
    frequency_hz: float = parameter(100.0, "Hz", 20.0, 1000.0, source="100 or 120 Hz")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the light averaged over the phase: unchanged."""
        return signal

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the light of one frame at a random phase."""
        return flicker_sample(signal, context, rng, self.modulation, self.frequency_hz, 0.0)

    def common_variance(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the variance that all pixels of a frame share."""
        left = flicker_variance(context.settings.exposure_s, self.frequency_hz, 0.0)
        return np.square(self.modulation * signal) * left
