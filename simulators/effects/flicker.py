"""Periodic modulation of light, averaged over an exposure."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

from simulators.effects.base import RADIANCE, KeepsMean, Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal

_HARMONICS: Final = 12  # the thirteenth of a square wave has 0.5 % of its variance


class Flicker(KeepsMean, CatalogueEffect):
    """Modulates light by m at a frequency f, at a new phase in every frame.

    A duty of 0 is a sine; otherwise a square wave that is on for that share of the period. Each harmonic of amplitude c
    is averaged over an exposure t to c·sinc(k·f·t), and has a variance of c²/2 from frame to frame.
    """

    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "exposure_s"
    block = "common"
    acts_by_square = True
    modulation: float
    frequency_hz: float
    duty: float = 0.0

    def _harmonics(self, exposure_s: Any) -> list[tuple[int, Any]]:
        """Return (k, amplitude) of each harmonic after the exposure, for unit modulation."""
        waves = [(1, 1.0)]
        if self.duty > 0:
            orders = range(1, _HARMONICS + 1)
            waves = [(k, 2.0 * float(np.sin(np.pi * k * self.duty)) / (np.pi * k * self.duty)) for k in orders]
        return [(k, c * np.sinc(k * self.frequency_hz * exposure_s)) for k, c in waves]

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the light of one frame that begins at a random phase; never below zero."""
        exposure_s = context.settings.exposure_s
        phase = self.frequency_hz * exposure_s / 2 + rng.random()
        wave = sum(c * np.cos(2.0 * np.pi * k * phase) for k, c in self._harmonics(exposure_s))
        return cast(Signal, (signal * max(0.0, 1.0 + self.modulation * float(wave))).astype(signal.dtype))

    def common_variance(self, signal: Signal, context: ExposureContext) -> Any:
        parts = [0.5 * np.square(c) for _, c in self._harmonics(context.settings.exposure_s)]
        return np.square(self.modulation * signal) * sum(parts[1:], parts[0])
