"""Charge that stays behind from the frame before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ImageLag(CatalogueEffect):
    """Adds a share of what the pixel held in the frame before: S' = S + l·S_prev.

    Source: incomplete charge transfer; typical 0.01 to 0.5 %.
    """

    name = "image_lag"
    stage = Stage.ELECTRONS
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    before = "shot_noise"
    where = "previous_frame"
    block = "mean"
    trials = (
        {"share": 0.002},
        {"share": 0.01},
    )
    fitted = ("share",)
    settles = "a bright capture followed at once by dark frames"
    share: float = parameter(0.0, "1", -0.2, 0.2, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the electrons with what was left behind."""
        return cast(Signal, (signal + self.share * self._left(signal, context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1, for the share of the own signal is far below it."""
        return 1.0

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the first frame's difference from the others."""
        previous = np.zeros(1) if context.previous_e is None else context.previous_e
        return replace(after, first_excess=before.first_excess + self.share * (previous - before.mean))

    def _left(self, signal: Signal, context: ExposureContext) -> Any:
        """Return what the frame before held; over a capture of n frames n − 1 of them follow one of their own kind."""
        previous = np.zeros(1, dtype=signal.dtype) if context.previous_e is None else context.previous_e
        frames: Any = getattr(context, "frames", None)
        return previous if frames is None else (previous + (frames - 1.0) * signal) / frames
