"""An exposure that is shorter while the frame before is still read out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import EXPOSURE, PRIOR, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ShutterDeadTime(CatalogueEffect):
    """Shortens every frame of a run but the first: H' = H·(t − Δt)/t in overlapped readout.

    With a growth g the k-th frame after the first loses Δt·(1 + g·(k − 1)); 0 where all lose alike.

    Source: C-BLUE user manual: dead times of 46 to 107 µs depending on the trigger.
    """

    name = "shutter_dead_time"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "first"
    log_prior_odds = -2.0
    prior_reason = "a constant added to the exposure is the usual error of timing"
    trials = ({"dead_time_s": 2e-06}, {"dead_time_s": 1e-05}, {"dead_time_s": 0.0001}, {"dead_time_s": -1e-05})
    fitted = ("dead_time_s",)
    further = ({"growth": 0.05},)
    settles = "single triggered frames and runs of frames at the shortest exposure"
    dead_time_s: float = parameter(0.0, "s", -0.01, 0.01, source=PRIOR)
    growth: float = parameter(0.0, "1", -1.0, 1.0, source="buffers fill up along a run")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the exposure; the first frame of a run has its full time."""
        return cast(Signal, (signal * self.slope(signal, context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        frames: Any = getattr(context, "frames", None)
        if frames is None:
            after = context.frame_index
            return self._kept(1.0 + self.growth * (after - 1.0), context) if after > 0 else 1.0
        return 1.0 - (frames - 1.0) / frames * (1.0 - self._kept(self._usual(frames), context))

    def _kept(self, dead_times: Any, context: ExposureContext) -> Any:
        """Return the share of its exposure that a frame keeps which loses so many dead times; never below nothing."""
        return np.maximum(1.0 - dead_times * self.dead_time_s / context.settings.exposure_s, 0.0)

    def ordered_variance(self, signal: Signal, context: ExposureContext) -> Any:
        later: Any = getattr(context, "frames", 1.0) - 1.0
        step = self.growth * self.dead_time_s / context.settings.exposure_s
        return np.square(signal * step) * (later > 1.0) * later * (later + 1.0) / 12.0 if self.growth else 0.0

    def _usual(self, frames: Any) -> Any:
        """Return the mean dead time of the frames after the first over that of the second."""
        return 1.0 + self.growth * np.maximum(frames - 2.0, 0.0) / 2.0

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        usual = self._usual(np.asarray(getattr(context, "frames", 1.0)))
        gained = before.mean * (1.0 - self._kept(usual, context))
        return after.changed(first_excess=after.first_excess + gained)
