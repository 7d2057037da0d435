"""Room light that reaches the sensor in addition to the source."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class AmbientLightLeak(Offset):
    """Adds light that the source's drive does not change: E' = E + a·((1 − l) + l·(4/N)²)·(1 + g·x + h·y).

    l is 0 for light that leaks past the lens and 1 for light that comes through it (a lit room). The coordinates x
    and y run from −1 to 1 over the sensor's longer side; g and h are 0 where the light is even.

    Source: a dark room leaks; typical 1e-6 to 1e-3 of the brightest patch.
    """

    name = "ambient_light_leak"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "source_level"
    block = "mean"
    trials = ({"irradiance_w_m2": 1e-06, "through_lens": 0.0},)
    fitted = ("irradiance_w_m2",)
    further = ({"tilt_x": 0.05, "tilt_y": 0.05},)
    settles = "frames with the lamp off and with the cap on"
    irradiance_w_m2: float = parameter(0.0, "W m-2", -1000.0, 1000000.0, source=PRIOR)
    through_lens: float = parameter(0.0, "1", 0.0, 1.0, source="0 past the lens, 1 through it")
    tilt_x: float = parameter(0.0, "1", -1.0, 1.0, source="a window or a gap is on one side")
    tilt_y: float = parameter(0.0, "1", -1.0, 1.0, source="the same from top to bottom")

    def offset(self, context: ExposureContext) -> Any:
        known: Any = 4.0 if context.f_number is None else context.f_number
        through = (4.0 / np.asarray(known)) ** 2
        x, y = context.geometry.sensor_xy()
        even = self.irradiance_w_m2 * (1.0 - self.through_lens + self.through_lens * through)
        return even * (1.0 + self.tilt_x * x + self.tilt_y * y) if self.tilt_x or self.tilt_y else even

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return starts at shares of the brightest patch's irradiance, past and through the lens."""
        peak = math.pi * context.peak_radiance / 64.0
        return tuple(cls(share * peak, through) for through in (0.0, 1.0) for share in (1e-6, 1e-4, 1e-2))
