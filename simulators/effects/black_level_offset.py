"""A black level that is not what the settings say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import DIGITAL_NUMBER, PRIOR, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class BlackLevelOffset(Offset):
    """Adds a constant to every value: y' = y + b + g·x + h·y; g and h are 0 for the same everywhere.

    x and y run from −1 to 1 over the sensor's longer side.

    Source: EMVA Standard 1288, release 4.0, mu_y.dark; typical 0.5 to 20 DN.
    """

    name = "black_level_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "signal"
    block = "mean"
    trials = ({"offset_dn": 1.0}, {"offset_dn": -1.0}, {"offset_dn": 10.0})
    fitted = ("offset_dn",)
    further = ({"tilt_x_dn": 0.02, "tilt_y_dn": 0.02},)
    settles = "dark frames at the shortest exposure at three gains"
    offset_dn: float = parameter(0.0, "DN", -1.0, 1.0, source=PRIOR, of_full_scale=True)
    tilt_x_dn: float = parameter(0.0, "DN", -0.025, 0.025, source="amplifiers settle along a line", of_full_scale=True)
    tilt_y_dn: float = parameter(0.0, "DN", -0.025, 0.025, source="references sag along a frame", of_full_scale=True)

    def offset(self, context: ExposureContext) -> Any:
        if not (self.tilt_x_dn or self.tilt_y_dn):
            return self.offset_dn
        x, y = context.geometry.sensor_xy()
        return self.offset_dn + self.tilt_x_dn * x + self.tilt_y_dn * y
