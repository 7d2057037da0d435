"""The shutter: irradiance to exposure."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import EXPOSURE, IRRADIANCE, Proportional, Stage
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class Shutter(Proportional):
    """Collects light for the exposure time: H = E·t; none while it is closed."""

    name = "shutter"
    stage = Stage.SHUTTER
    unit_in = IRRADIANCE
    unit_out = EXPOSURE

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.settings.exposure_s * (1.0 - context.settings.is_dark)
