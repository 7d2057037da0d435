"""An exposure time that is off by a constant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ExposureTimeOffset(Scaling):
    """Adds a constant to the exposure time: H' = H·(t + Δt)/t.

    Source: ARTCAM-264IMX manual: exposure = lines × 13.28 µs + 13.73 µs; AVT, ExpOffset; typical 1 to 15 µs.
    """

    name = "exposure_time_offset"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = (
        {"offset_s": 2e-06},
        {"offset_s": 1e-05},
        {"offset_s": -2e-06},
        {"offset_s": -1e-05},
        {"offset_s": 0.0001},
    )
    fitted = ("offset_s",)
    settles = "exposures down to ten times the offset at one source level"
    offset_s: float = parameter(0.0, "s", -0.1, 0.1, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return real over stated exposure time; never negative."""
        time = context.settings.exposure_s
        return np.maximum(time + self.offset_s, 0.0) / time
