"""A screen whose black is not black."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class DisplayBlackLeak(Offset):
    """Adds backlight: L' = L + b·L_peak·d.

    Source: contrast of LCD panels: 1/500 to 1/5000 of white.
    """

    name = "display_black_leak"
    stage = Stage.SCENE
    unit_in = unit_out = RADIANCE
    where = "patch_level"
    block = "mean"
    trials = ({"share": 0.001}, {"share": 0.01})
    fitted = ("share",)
    settles = "the same patches with a bright and with a dark surround, and the lamp off"
    share: float = parameter(0.0, "1", -0.05, 10.0, source="of white; a picture of a contrast of 1.1 is just seen")

    def offset(self, context: ExposureContext) -> Any:
        return self.share * context.peak_radiance * context.settings.source_level
