"""A screen that is brighter in one place than in another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class DisplayNonuniformity(Scaling):
    """Scales light over the screen: L' = L·(1 + a·u + b·v + c·u² + d·u·v + e·v²), u and v from −1 to 1.

    Source: backlights; typical 2 to 20 % from centre to corner.
    """

    name = "display_nonuniformity"
    stage = Stage.SOURCE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "screen_x"
    block = "slope"
    trials = (
        {"a": 0.02},
        {"b": 0.02},
        {"c": 0.02},
        {"d": 0.02},
        {"e": 0.02},
    )
    fitted = (
        "a",
        "b",
        "c",
        "d",
        "e",
    )
    settles = "the screen turned or shifted against the camera"
    a: float = parameter(0.0, "1", -2.0, 2.0, source="engineering prior; refined on a real rig")
    b: float = parameter(0.0, "1", -2.0, 2.0, source="engineering prior; refined on a real rig")
    c: float = parameter(0.0, "1", -2.0, 2.0, source="engineering prior; refined on a real rig")
    d: float = parameter(0.0, "1", -2.0, 2.0, source="engineering prior; refined on a real rig")
    e: float = parameter(0.0, "1", -2.0, 2.0, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return the screen's radiance over that of its middle."""
        u, v = context.geometry.screen_xy()
        bent = self.c * u * u + self.d * u * v + self.e * v * v
        return np.maximum(1.0 + self.a * u + self.b * v + bent, 0.01)
