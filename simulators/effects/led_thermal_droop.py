"""A LED that gets hot and weak at high drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import PRIOR, RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_MOST_LEVELS: Final = 16  # a free entry for each of more would fit anything


@dataclass(frozen=True)
class LedThermalDroop(Scaling):
    """Weakens light by drive: L' = L·(1 − k·d − k₂·d² − k₃·d³)·(1 + table(d)); a smooth droop has no table.

    The table (linear in log d between its levels) serves any other law.

    Source: LED datasheets, relative flux over current; typical 1 to 10 %.
    """

    name = "led_thermal_droop"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "source_level"
    block = "mean"
    trials = ({"droop_rel": 0.02, "curvature_rel": 0.0}, {"droop_rel": -0.02, "curvature_rel": 0.0})
    fitted = ("droop_rel",)
    settles = "several source levels at one exposure"
    droop_rel: float = parameter(0.0, "1", -0.9, 0.9, source=PRIOR)
    curvature_rel: float = parameter(0.0, "1", -0.9, 0.9, source=PRIOR)
    bend_rel: float = parameter(0.0, "1", -0.9, 0.9, source="heat that is led off well until some drive")
    levels: tuple[float, ...] = parameter((), "1", 1e-9, 1e3, source="drives at which the table holds an error")
    errors_rel: tuple[float, ...] = parameter((), "1", -0.9, 3.0, source="relative error at these drives")

    def factor(self, context: ExposureContext) -> Any:
        level = np.asarray(context.settings.source_level)
        law = np.maximum(1.0 - self.droop_rel * level - self.curvature_rel * level**2 - self.bend_rel * level**3, 0.01)
        if not self.levels:
            return law
        known = np.log(np.maximum(level, 1e-9))
        return law * (1.0 + np.interp(known, np.log(self.levels), self.errors_rel))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        level = np.asarray(context.settings.source_level)
        return bool(np.unique(level[level > 0]).size > 1)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law with curvature."""
        return (cls(0.01, 0.01),)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law of one term more, and the table over the levels in use, which covers every law."""
        level = np.asarray(context.settings.source_level)
        used = np.unique(level[level > 0])
        if self.levels or not 3 <= used.size <= _MOST_LEVELS:
            return ()
        table = type(self)(levels=tuple(used.tolist()), errors_rel=(0.0,) * used.size)
        if not self.curvature_rel:
            return (self.with_parameters(curvature_rel=0.01), table)
        return (table,) if self.bend_rel else (self.with_parameters(bend_rel=0.001), table)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: further terms only where there are any, the table but for its highest level."""
        if self.levels:
            return tuple(f"errors_rel[{index}]" for index in range(len(self.levels) - 1))
        further = ("bend_rel",) if self.bend_rel else ()
        return ("droop_rel", "curvature_rel", *further) if self.curvature_rel else ("droop_rel",)
