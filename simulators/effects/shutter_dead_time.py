"""An exposure that is shorter while the frame before is still read out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ShutterDeadTime(CatalogueEffect):
    """Shortens every frame of a run but the first: H' = H·(t − Δt)/t in overlapped readout.

    Source: C-BLUE user manual: dead times of 46 to 107 µs depending on the trigger.
    """

    name = "shutter_dead_time"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "first"
    trials = (
        {"dead_time_s": 2e-06},
        {"dead_time_s": 1e-05},
        {"dead_time_s": 0.0001},
        {"dead_time_s": -1e-05},
    )
    fitted = ("dead_time_s",)
    settles = "single triggered frames beside runs of frames at the shortest exposure"
    dead_time_s: float = parameter(0.0, "s", -0.01, 0.01, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the exposure; the first frame of a run has its full time."""
        return cast(Signal, (signal * self.slope(signal, context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        """Return real over stated exposure time (of a whole run: its average)."""
        frames: Any = getattr(context, "frames", None)
        later = float(context.frame_index > 0) if frames is None else (frames - 1.0) / frames
        return 1.0 - later * self.dead_time_s / context.settings.exposure_s

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what the first frame has more."""
        gained = before.mean * self.dead_time_s / context.settings.exposure_s
        return replace(after, first_excess=after.first_excess + gained)
