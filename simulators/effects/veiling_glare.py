"""Light that the lens scatters over the whole picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.surroundings import surroundings_of


@dataclass(frozen=True)
class VeilingGlare(CatalogueEffect):
    """Spreads a share of all light evenly: E' = (1 − v)·E + v·mean(E)·(1 + g·x + h·y + c·(ρ² − ½)).

    ρ is 1 in the corner, x and y are in the same unit; g, h and c are 0 for an even veil.

    Source: ISO 9358; typical 0.2 to 3 %.
    """

    name = "veiling_glare"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "patch_level"
    block = "mean"
    trials = ({"share": 0.005}, {"share": 0.02})
    fitted = ("share",)
    further = ({"tilt_x": 0.01, "tilt_y": 0.01, "bowl": 0.01},)
    settles = "the same patches with a bright and with a dark surround"
    share: float = parameter(0.0, "1", -0.05, 0.5, source=PRIOR)
    tilt_x: float = parameter(0.0, "1", -1.0, 1.0, source="reflections in the barrel are brighter on one side")
    tilt_y: float = parameter(0.0, "1", -1.0, 1.0, source="the same downwards")
    bowl: float = parameter(0.0, "1", -1.0, 1.0, source="change from middle to corner; ISO 9358 asks for it")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        veil = self.share * surroundings_of(context).frame_mean(signal) * self._field(context)
        return cast(Signal, (signal * (1.0 - self.share) + veil).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 - self.share

    @property
    def _is_uneven(self) -> bool:
        return bool(self.tilt_x or self.tilt_y or self.bowl)

    def _field(self, context: ExposureContext) -> Any:
        if not self._is_uneven:
            return 1.0
        x, y = context.geometry.field_xy()
        return 1.0 + self.tilt_x * x + self.tilt_y * y + self.bowl * (np.square(x) + np.square(y) - 0.5)
