"""The drive of the light source."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import RADIANCE, Proportional, Stage
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class SourceLevel(Proportional):
    """Scales the scene by the source's relative drive: L = d·L₁."""

    name = "source_level"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.settings.source_level
