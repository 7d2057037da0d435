"""The lens: radiance in the scene to irradiance on the sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from radiometer.errors import ConfigurationError
from simulators.effects.base import IRRADIANCE, RADIANCE, Proportional, Stage, parameter
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class Lens(Proportional):
    """Images a scene onto the sensor: E = π·τ·L·cos⁴α / (4·N²·(1 + m/p)²).

    N is the frame's f-number. With `cos4` 0 the fall-off is left out (a lens corrected for it, or a base model
    that does not hold it).

    Source: camera equation for a lens of pupil magnification p and image magnification m; cos⁴ law.
    """

    name = "lens"
    stage = Stage.OPTICS
    unit_in = RADIANCE
    unit_out = IRRADIANCE
    transmittance: float = parameter(1.0, "1", 0.01, 1.0, source="1 is a lossless lens; uncoated singlets 0.92")
    magnification: float = parameter(0.0, "1", 0.0, 10.0, source="0 is a far object")
    pupil_magnification: float = parameter(1.0, "1", 0.1, 10.0, source="1 is a symmetric lens")
    focal_length_mm: float = parameter(16.0, "mm", 0.5, 5000.0, source="engraved on the lens; sets the field angle")
    cos4: float = parameter(0.0, "1", 0.0, 1.0, source="1 for the natural fall-off, 0 for none")

    def slope(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return irradiance per radiance in sr. Raises ConfigurationError where the f-number is unknown."""
        if context.f_number is None:
            raise ConfigurationError("the f-number is unknown: give lens.f_number or the frame's f_number")
        closeness = 1.0 + self.magnification / self.pupil_magnification
        on_axis = math.pi * self.transmittance / (4.0 * (context.f_number * closeness) ** 2)
        return on_axis * self._falloff(context).astype(signal.dtype) if self.cos4 else on_axis

    def _falloff(self, context: ExposureContext) -> Signal:
        """Return cos⁴α from tan α = r/(f·(1 + m/p)); 1 where `cos4` is 0."""
        closeness = 1.0 + self.magnification / self.pupil_magnification
        tangent = context.geometry.radius_um() / (1000.0 * self.focal_length_mm * closeness)
        cos4: Signal = np.square(1.0 / (1.0 + np.square(tangent)))
        return 1.0 + self.cos4 * (cos4 - 1.0)
