"""The offset that keeps dark noise above zero."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import DIGITAL_NUMBER, Stage, UnitSlope, parameter
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class BlackLevel(UnitSlope):
    """Adds the black level of the frame's settings, in native DN; its own value where the settings give none."""

    name = "black_level"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    black_level_dn: float = parameter(
        0.0, "DN", 0.0, 1.0, source="datasheet; used where the frame gives none", of_full_scale=True
    )

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        level = context.settings.black_level_dn
        return signal + (self.black_level_dn if level is None else level)
