"""The fall-off of light towards the corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class NaturalVignetting(Scaling):
    """Weakens light off the axis: E' = E·(1 + s·ρ²)^−2·(1 − k₄·ρ⁴), ρ the field radius (1 in the corner).

    s is (half diagonal / focal length)² for the cos⁴ law; k₄ takes up what a real lens adds. ρ counts from the stated
    principal point, or from where the lens's axis really is, (x, y) beside it in half diagonals.

    Source: cos⁴ law; ρ⁴ term after Goldman (2010).
    """

    name = "natural_vignetting"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "field_radius"
    block = "slope"
    trials = (
        {"strength": 0.02, "k4": 0.0},
        {"strength": 0.1, "k4": 0.0},
        {"strength": 0.0, "k4": 0.03},
    )
    fitted = (
        "strength",
        "k4",
    )
    settles = "the screen turned or shifted against the camera"
    stands_for = ("angle_dependence",)  # where no stop changes it
    essential = ("strength",)  # every lens has it; a fall-off towards the corners alone is cut off, not oblique
    strength: float = parameter(0.0, "1", -0.3, 3.0, source="engineering prior; refined on a real rig")
    k4: float = parameter(0.0, "1", -1.0, 1.0, source="engineering prior; refined on a real rig")

    axis_x: float = parameter(0.0, "1", -0.5, 0.5, source="lenses sit off the sensor's middle by up to a tenth")
    axis_y: float = parameter(0.0, "1", -0.5, 0.5, source="the same downwards")

    def factor(self, context: ExposureContext) -> Any:
        """Return the fall-off."""
        x, y = context.geometry.field_xy()
        rho2 = np.square(x - self.axis_x) + np.square(y - self.axis_y)
        return (1.0 + self.strength * rho2) ** -2.0 * (1.0 - self.k4 * rho2**2)

    @classmethod
    def in_place_of_others(cls) -> Self:
        """Return the plain law."""
        return cls(0.03)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the plain law about an axis of its own."""
        return (cls(0.02, 0.0, 0.01, 0.01),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the axis in place of k₄ where it is not the stated one."""
        return ("strength", "axis_x", "axis_y") if self.axis_x or self.axis_y else self.fitted
