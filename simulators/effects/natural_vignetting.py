"""The fall-off of light towards the corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_BENT: Final = 0.01  # k₄ from which a fit begins


@dataclass(frozen=True)
class NaturalVignetting(Scaling):
    """Weakens light off the axis: E' = E·(1 + s·ρ²)^−2·(1 − k₄·ρ⁴), ρ the field radius (1 in the corner).

    s is (half diagonal / focal length)² for the cos⁴ law; k₄ takes up what a real lens adds. The radius ρ counts from
    the stated principal point, or from the lens's real axis, (x, y) away from it in half diagonals.

    Source: cos⁴ law; ρ⁴ term after Goldman (2010).
    """

    name = "natural_vignetting"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "field_radius"
    block = "slope"
    trials = ({"strength": 0.02, "k4": 0.0}, {"strength": 0.1, "k4": 0.0}, {"strength": 0.0, "k4": 0.03})
    fitted = ("strength", "k4")
    settles = "the screen turned or shifted against the camera"
    essential = ("strength",)  # every lens has it; a fall-off towards the corners alone is cut off, not oblique
    strength: float = parameter(0.0, "1", -0.3, 3.0, source=PRIOR)
    k4: float = parameter(0.0, "1", -1.0, 1.0, source=PRIOR)
    axis_x: float = parameter(0.0, "1", -0.5, 0.5, source="lenses sit off the sensor's middle by up to a tenth")
    axis_y: float = parameter(0.0, "1", -0.5, 0.5, source="the same downwards")

    def factor(self, context: ExposureContext) -> Any:
        x, y = context.geometry.field_xy()
        rho2 = np.square(x - self.axis_x) + np.square(y - self.axis_y)
        return (1.0 + self.strength * rho2) ** -2.0 * (1.0 - self.k4 * rho2**2)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the plain law about a separate axis."""
        return (cls(0.02, 0.0, 0.01, 0.01),)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law about a separate axis, plain and with k₄."""
        if not (self.axis_x or self.axis_y):
            (plain,) = self.covers(context)
            return tuple(plain.with_parameters(strength=self.strength, k4=k4) for k4 in (0.0, self.k4 or _BENT))
        return () if self.k4 else (self.with_parameters(k4=_BENT),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: of an axis that is not the stated one its place too, and k₄ where it is not 0.

        A k₄ that was fitted is free there as well: else the parameter would cost nothing.
        """
        if not (self.axis_x or self.axis_y):
            return self.fitted
        return ("strength", *(("k4",) if self.k4 else ()), "axis_x", "axis_y")
