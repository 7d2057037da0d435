"""Microlenses that take in slanting light badly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class AngleDependence(Scaling):
    """Weakens steep rays: E' = E·(1 − a·ρ^p·N^−q)·(1 − c·N^−2), by default with p = 2, q = 1 and c = 0.

    Source: chief-ray angle shading of microlenses; linear in the cone 1/N. Where the microlenses reject a narrow
    slanting cone that they would take in part of, if it were wide, q is negative. Where they lose the rim of a wide
    cone everywhere (pixel vignetting), c is above zero; with q = 0 slant and cone act each by itself.
    """

    name = "angle_dependence"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "slope"
    law_along = ("field_radius", "f_number")
    log_prior_odds = -2.0
    prior_reason = "bends like the fall-off of any lens"
    trials = ({"strength": 0.05}, {"strength": -0.05})
    fitted = ("strength",)
    varies = "f_number"
    settles = "an even field with the camera tilted"
    # A fall-off that no stop changes is the lens, a loss at wide stops that is the same all over is its transmission.
    essential = ("strength", "stop_power", "cone")
    strength: float = parameter(0.0, "1", -3.0, 3.0, source=PRIOR)
    radius_power: float = parameter(2.0, "1", 1.0, 6.0, source="microlenses are shifted for the inner field")
    stop_power: float = parameter(
        1.0, "1", -2.0, 1.0, source="cone and chief ray weigh differently from pixel to pixel"
    )
    cone: float = parameter(0.0, "1", -1.0, 1.0, source="pixel vignetting at f/1.4 takes up to a third")

    def factor(self, context: ExposureContext) -> Any:
        stopped: Any = 8.0 if context.f_number is None else context.f_number
        loss = self.strength * context.geometry.field_radius() ** self.radius_power
        slant = 1.0 - loss * np.asarray(stopped) ** -self.stop_power
        return np.maximum(slant * (1.0 - self.cone * np.asarray(stopped) ** -2.0), 0.01)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form with separate powers."""
        return (cls(0.01, 2.5, -0.5),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the cone where it acts apart, the powers where they are not the plain ones."""
        if self.stop_power == 0.0:
            return ("strength", "cone")
        plain = self.radius_power == 2.0 and self.stop_power == 1.0
        return ("strength",) if plain else ("strength", "radius_power", "stop_power")
