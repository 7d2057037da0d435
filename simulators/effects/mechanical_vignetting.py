"""Corners that the barrel of the lens cuts off at large apertures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class MechanicalVignetting(Scaling):
    """Weakens corners at small f-numbers: E' = E·(1 − m·ρ^p·(2/N)^q), or by the pupil that the barrel leaves free.

    p is 4, or 2 where the loss begins nearer to the middle.

    With a barrel E' = E·A(2/N, b, s·ρ·(2/N)^w)·(N/2)²/π, where A is the area common to the pupil (a circle of radius
    2/N), and the barrel's opening. The opening has radius b and, seen from ρ, is displaced by s·ρ. Lengths are in
    radii of the pupil at f/2. w is 0 where the barrel stands still before the iris, above 0 where the pupil takes it
    along. Nothing is lost within a circle that grows with N.

    Source: lens barrels; vanishes one to two stops above the smallest f-number.
    """

    name = "mechanical_vignetting"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "slope"
    law_along = ("field_radius", "f_number")
    trials = (
        {"strength": 0.05, "exponent": 2.0},
        {"strength": 0.05, "exponent": 4.0},
        {"strength": 0.2, "exponent": 2.0},
        {"strength": 0.05, "exponent": 2.0, "radius_power": 2.0},
    )
    fitted = ("strength", "exponent")
    varies = "f_number"
    settles = "an even field at several f-numbers"
    strength: float = parameter(0.0, "1", -1.0, 1.0, source="at f/2 in the corner")
    exponent: float = parameter(2.0, "1", 1.5, 8.0, source="how fast it vanishes when stopping down")
    radius_power: float = parameter(4.0, "1", 2.0, 6.0, source="how late it sets in towards the corner")
    barrel: float = parameter(0.0, "1", 0.0, 20.0, source="radius of the barrel's opening; 0 for the law alone")
    shift: float = parameter(0.0, "1", 0.0, 20.0, source="its displacement as seen from the corner")
    wander: float = parameter(0.0, "1", -5.0, 5.0, source="how far the displacement scales with the pupil's size")

    def factor(self, context: ExposureContext) -> Any:
        stopped: Any = 8.0 if context.f_number is None else context.f_number
        pupil, rho = 2.0 / np.asarray(stopped), context.geometry.field_radius()
        law = np.maximum(1.0 - self.strength * rho**self.radius_power * pupil**self.exponent, 0.01)
        if not self.barrel:
            return law
        free = common_area(pupil, self.barrel, self.shift * rho * pupil**self.wander) / (math.pi * pupil**2)
        return law * np.maximum(free, 0.01)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return barrels a little wider than the widest pupil."""
        if context.f_number is None:
            return ()
        pupil = 2.0 / float(np.min(np.asarray(context.f_number)))
        forms = ((1.1, 0.4, 0.0), (1.25, 0.7, 0.0), (1.25, 0.7, 1.0))
        return tuple(cls(0.0, 2.0, 4.0, b * pupil, s * pupil ** (1.0 - w), w) for b, s, w in forms)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return () if self.barrel else self.covers(context)

    def free(self) -> tuple[str, ...]:
        return ("barrel", "shift", "wander") if self.barrel else self.fitted


def common_area(first: Any, second: Any, distance: Any) -> Any:
    """Return the area that two circles have in common.

    Args:
        distance: Distance of their centres, in the same unit.

    Source: circular segments of half-angle α, r²·(α − sin α·cos α), on either side of the common chord.
    """
    apart = np.maximum(distance, 1e-9)
    total: Any = 0.0
    for own, other in ((first, second), (second, first)):
        cosine = np.clip((apart**2 + np.square(own) - np.square(other)) / (2.0 * apart * own), -1.0, 1.0)
        total = total + np.square(own) * (np.arccos(cosine) - cosine * np.sqrt(1.0 - cosine**2))
    return total
