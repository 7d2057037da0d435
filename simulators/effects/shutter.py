"""The shutter: irradiance to exposure."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import EXPOSURE, IRRADIANCE, Effect, Stage
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class Shutter(Effect):
    """Collects light for the exposure time: H = E·t; none while it is closed."""

    name = "shutter"
    stage = Stage.SHUTTER
    unit_in = IRRADIANCE
    unit_out = EXPOSURE

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.slope(signal, context)

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.settings.exposure_s * (1.0 - context.settings.is_dark)
