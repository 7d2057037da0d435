"""Corners that the barrel of the lens cuts off at large apertures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling, f_number_varies
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class MechanicalVignetting(Scaling):
    """Weakens corners at small f-numbers: E' = E·(1 − m·ρ⁴·(2/N)^q).

    Source: lens barrels; vanishes one to two stops above the smallest f-number.
    """

    name = "mechanical_vignetting"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "f_number"
    block = "slope"
    trials = (
        {"strength": 0.05, "exponent": 2.0},
        {"strength": 0.05, "exponent": 4.0},
        {"strength": 0.2, "exponent": 2.0},
    )
    fitted = (
        "strength",
        "exponent",
    )
    settles = "an even field at several f-numbers"
    strength: float = parameter(0.0, "1", -1.0, 1.0, source="at f/2 in the corner")
    exponent: float = parameter(2.0, "1", 0.5, 8.0, source="how fast it vanishes when stopping down")

    def factor(self, context: ExposureContext) -> Any:
        """Return the fall-off."""
        stopped: Any = 8.0 if context.f_number is None else context.f_number
        loss = self.strength * context.geometry.field_radius() ** 4 * (2.0 / np.asarray(stopped)) ** self.exponent
        return np.maximum(1.0 - loss, 0.01)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the f-number varies."""
        return f_number_varies(context)
