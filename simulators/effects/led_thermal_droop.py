"""A LED that gets hot and weak at high drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class LedThermalDroop(Scaling):
    """Weakens light by drive: L' = L·(1 − k·d − k₂·d²).

    Source: LED datasheets, relative flux over current; typical 1 to 10 %.
    """

    name = "led_thermal_droop"
    stage = Stage.SOURCE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "source_level"
    block = "mean"
    trials = (
        {"droop_rel": 0.02, "curvature_rel": 0.0},
        {"droop_rel": -0.02, "curvature_rel": 0.0},
    )
    fitted = ("droop_rel",)
    settles = "several source levels at one exposure"
    droop_rel: float = parameter(0.0, "1", -0.9, 0.9, source="engineering prior; refined on a real rig")
    curvature_rel: float = parameter(0.0, "1", -0.9, 0.9, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return light over drive."""
        level = np.asarray(context.settings.source_level)
        return np.maximum(1.0 - self.droop_rel * level - self.curvature_rel * level**2, 0.01)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the source level varies among lit frames."""
        level = np.asarray(context.settings.source_level)
        return bool(np.unique(level[level > 0]).size > 1)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law with curvature."""
        return (cls(0.01, 0.01),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the curvature only where there is one."""
        return ("droop_rel", "curvature_rel") if self.curvature_rel else ("droop_rel",)
