"""A camera that sees polarised light differently."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class Polarisation(Scaling):
    """Weakens polarised light by angle: E' = E·(1 + p·cos 2(φ − φ₀)), φ the angle of camera to screen.

    Source: LCD screens are polarised; lens coatings and beam splitters are not neutral.
    """

    name = "polarisation"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "screen_x"
    block = "mean"
    trials = ({"strength": 0.02, "axis_rad": 0.0}, {"strength": 0.02, "axis_rad": 0.8})
    fitted = ("strength", "axis_rad")
    settles = "the camera turned by 45 and by 90 degrees"
    strength: float = parameter(0.0, "1", -0.5, 0.5, source=PRIOR)
    axis_rad: float = parameter(0.0, "rad", -3.2, 3.2, source="angle of the largest response")

    def factor(self, context: ExposureContext) -> Any:
        return 1.0 + self.strength * np.cos(2.0 * (context.geometry.screen_rotation_rad - self.axis_rad))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.ptp(np.asarray(context.geometry.screen_rotation_rad)) > 0)
