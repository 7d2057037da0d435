"""Microlenses that take in slanting light badly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling, f_number_varies
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class AngleDependence(Scaling):
    """Weakens steep rays: E' = E·(1 − a·ρ²/N).

    Source: chief-ray angle shading of microlenses; linear in the cone 1/N.
    """

    name = "angle_dependence"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "f_number"
    block = "slope"
    trials = (
        {"strength": 0.05},
        {"strength": -0.05},
    )
    fitted = ("strength",)
    settles = "an even field with the camera tilted"
    strength: float = parameter(0.0, "1", -3.0, 3.0, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor."""
        stopped: Any = 8.0 if context.f_number is None else context.f_number
        return np.maximum(1.0 - self.strength * context.geometry.field_radius() ** 2 / np.asarray(stopped), 0.01)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the f-number varies."""
        return f_number_varies(context)
