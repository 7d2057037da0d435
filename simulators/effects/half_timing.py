"""Halves of the sensor that are exposed for different times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext
from simulators.effects.quarters import by_quarter


@dataclass(frozen=True)
class HalfTiming(Scaling):
    """Exposes the halves of a sensor for t − τ and t + τ, one above the other or side by side: H' = H·(t ± τ)/t.

    Source: sensors that are read from both ends start and stop each half by signals of its driver; typical 1 to 100 µs.
    """

    name = "half_timing"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "slope"
    also = ("mean",)
    is_steep = True
    signal_power = 1
    log_prior_odds = -1.0
    prior_reason = "most sensors have one driver of the shutter"
    trials = tuple({"half_s": size, "sideways": side} for side in (0.0, 1.0) for size in (1e-05, -1e-05))
    fitted = ("half_s",)
    settles = "an even field at exposures down to ten times the difference"
    half_s: float = parameter(0.0, "s", -0.01, 0.01, source="half the difference between below and above: 1 to 100 µs")
    sideways: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the halves are side by side: right against left")

    def factor(self, context: ExposureContext) -> Any:
        added = by_quarter(context, self.sideways * self.half_s, (1.0 - self.sideways) * self.half_s, 0.0)
        return np.maximum(1.0 + added / context.settings.exposure_s, 0.0)
