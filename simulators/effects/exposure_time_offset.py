"""An exposure time that is off by a constant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import EXPOSURE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_MOST_GAINS: Final = 16  # more are a sweep: a start at each would only cost time


@dataclass(frozen=True)
class ExposureTimeOffset(Scaling):
    """Adds a constant to the exposure time: H' = H·(t + Δt)/t, with Δt + δ above a gain g₀; δ is 0 for one constant.

    Sensors change their read-out above some gain, and its timing with it.

    Source: ARTCAM-264IMX manual: exposure = lines × 13.28 µs + 13.73 µs; AVT, ExpOffset; typical 1 to 15 µs.
    """

    name = "exposure_time_offset"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = tuple({"offset_s": offset} for offset in (2e-06, 1e-05, -2e-06, -1e-05, 0.0001))
    fitted = ("offset_s",)
    bends = ("further_s",)
    settles = "exposures down to ten times the offset at one source level"
    offset_s: float = parameter(0.0, "s", -0.1, 0.1, source=PRIOR)
    further_s: float = parameter(0.0, "s", -0.1, 0.1, source="change of the offset above a gain")
    above_db: float = parameter(0.0, "dB", -20.0, 100.0, source="that gain; between two of those in use")

    def factor(self, context: ExposureContext) -> Any:
        time = context.settings.exposure_s
        further: Any = 0.0
        if self.further_s:
            further = np.where(np.asarray(context.settings.gain_db) > self.above_db, self.further_s, 0.0)
        return np.maximum(time + self.offset_s + further, 0.0) / time

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the offsets that change between two of the gains in use."""
        gains = np.unique(np.asarray(context.settings.gain_db))
        if self.further_s or not 2 <= gains.size <= _MOST_GAINS:
            return ()
        between = (gains[1:] + gains[:-1]) / 2.0
        return tuple(self.with_parameters(further_s=self.offset_s / 10.0, above_db=g) for g in between.tolist())
