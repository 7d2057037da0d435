"""A screen that is brighter in one place than in another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import PRIOR, RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class DisplayNonuniformity(Scaling):
    """Scales light over the screen: L' = L·(1 + a·u + b·v + c·u² + d·u·v + e·v² + …), u and v from −1 to 1.

    `cubic` holds the factors of u³, u²v, uv², v³ and `quartic` those of u⁴, u³v, u²v², uv³, v⁴; both are empty for a
    screen that a quadratic form describes.

    Source: backlights; typical 2 to 20 % from centre to corner.
    """

    name = "display_nonuniformity"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "screen_x"
    block = "slope"
    trials = ({"a": 0.02}, {"b": 0.02}, {"c": 0.02}, {"d": 0.02}, {"e": 0.02})
    fitted = ("a", "b", "c", "d", "e")
    settles = "the screen turned or shifted against the camera"
    a: float = parameter(0.0, "1", -2.0, 2.0, source=PRIOR)
    b: float = parameter(0.0, "1", -2.0, 2.0, source=PRIOR)
    c: float = parameter(0.0, "1", -2.0, 2.0, source=PRIOR)
    d: float = parameter(0.0, "1", -2.0, 2.0, source=PRIOR)
    e: float = parameter(0.0, "1", -2.0, 2.0, source=PRIOR)
    cubic: tuple[float, ...] = parameter((), "1", -2.0, 2.0, source="lamps of a backlight show as a slow wave")
    quartic: tuple[float, ...] = parameter((), "1", -2.0, 2.0, source="the same")

    def factor(self, context: ExposureContext) -> Any:
        u, v = context.geometry.screen_xy()
        bent = self.c * u * u + self.d * u * v + self.e * v * v
        for terms in (self.cubic, self.quartic):
            order = len(terms) - 1
            bent = bent + sum(term * u ** (order - n) * v**n for n, term in enumerate(terms) if term)
        return np.maximum(1.0 + self.a * u + self.b * v + bent, 0.01)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form of the fourth order: a slow wave looks like a lens at the second."""
        return (cls(a=0.02, cubic=(0.001,) * 4, quartic=(0.001,) * 5),)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form of the next order: cubic, then quartic."""
        if not self.cubic:
            return (self.with_parameters(cubic=(0.001,) * 4),)
        return () if self.quartic else (self.with_parameters(quartic=(0.001,) * 5),)

    def free(self) -> tuple[str, ...]:
        cubic = (f"cubic[{n}]" for n in range(len(self.cubic)))
        return (*self.fitted, *cubic, *(f"quartic[{n}]" for n in range(len(self.quartic))))
