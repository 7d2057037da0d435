"""The fall-off of light towards the corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class NaturalVignetting(Scaling):
    """Weakens light off the axis: E' = E·(1 + s·ρ²)^−2·(1 − k₄·ρ⁴), ρ the field radius (1 in the corner).

    s is (half diagonal / focal length)² for the cos⁴ law; k₄ takes up what a real lens adds.

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
    strength: float = parameter(0.0, "1", -0.3, 3.0, source="engineering prior; refined on a real rig")
    k4: float = parameter(0.0, "1", -1.0, 1.0, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return the fall-off."""
        rho2 = np.square(context.geometry.field_radius())
        return (1.0 + self.strength * rho2) ** -2.0 * (1.0 - self.k4 * rho2**2)
