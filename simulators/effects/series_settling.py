"""A source that settles within each series of frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class SeriesSettling(Scaling):
    """Scales the light of the k-th frame after a change of settings: L' = L·(1 + a·r^k), k = 0, 1, 2 …

    With r near 1 the light goes in a line from frame to frame.

    Source: lamps and LEDs that are switched on for each setting warm up within its frames; auto-levels that run on.
    """

    name = "series_settling"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "previous_frame"
    block = "first"
    also = ("common",)
    log_prior_odds = -2.0
    prior_reason = "most sources are on all the time, and settle once in a session"
    trials = tuple({"excess_rel": a, "ratio": r} for r in (0.3, 0.7, 0.95) for a in (0.01, -0.01))
    fitted = ("excess_rel", "ratio")
    settles = "ten frames of one setting in a row, with light and in the dark"
    excess_rel: float = parameter(0.0, "1", -0.9, 9.0, source="tenths of a percent to some percent")
    ratio: float = parameter(0.3, "1", 0.0, 0.98, source="from frame to frame; 0 for the first frame alone")

    def factor(self, context: ExposureContext) -> Any:
        """Return the light of one frame over that of a settled source; of a series, the mean of its frames."""
        frames: Any = getattr(context, "frames", None)
        share = self.ratio**context.frame_index if frames is None else self._powers(frames, 1.0, 0.0) / frames
        return 1.0 + self.excess_rel * share

    def ordered_variance(self, signal: Signal, context: ExposureContext) -> Any:
        frames: Any = getattr(context, "frames", 1.0)
        counted = np.maximum(frames - 1.0, 1.0)
        mean = self._powers(frames, 1.0, 1.0) / counted
        square = self._powers(frames, 2.0, 1.0) / counted
        unbiased = counted / np.maximum(counted - 1.0, 1.0)
        return np.square(signal * self.excess_rel) * np.maximum(square - np.square(mean), 0.0) * unbiased

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        frames: Any = getattr(context, "frames", 1.0)
        later = self._powers(frames, 1.0, 1.0) / np.maximum(frames - 1.0, 1.0)
        moved: Any = before.mean * self.excess_rel * np.where(frames > 1, 1.0 - later, 0.0)
        return after.changed(first_excess=after.first_excess + moved)

    def _powers(self, frames: Any, power: float, first: Any) -> Any:
        """Return the sum of r^(p·k) over the frames k from `first` on."""
        step = self.ratio**power
        return (step**first - step**frames) / (1.0 - step)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.max(np.asarray(getattr(context, "frames", 2.0))) > 1)
