"""Flicker that a rolling shutter turns into bands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class RollingShutterBanding(CatalogueEffect):
    """Modulates light from row to row: L' = L·(1 + m·sinc(f·t)·cos(2π·f·t_row·row + φ)), φ new in every frame.

    Source: mains or dimming flicker under a rolling shutter; only with row-by-row exposure.
    """

    name = "rolling_shutter_banding"
    stage = Stage.SOURCE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "image_y"
    block = "row_temporal"
    trials = (
        {"modulation": 0.02, "frequency_hz": 100.0, "row_time_s": 1e-05},
        {"modulation": 0.02, "frequency_hz": 100.0, "row_time_s": 5e-05},
        {"modulation": 0.02, "frequency_hz": 100.0, "row_time_s": 0.0002},
        {"modulation": 0.02, "frequency_hz": 1000.0, "row_time_s": 1e-05},
        {"modulation": 0.02, "frequency_hz": 1000.0, "row_time_s": 5e-05},
        {"modulation": 0.02, "frequency_hz": 1000.0, "row_time_s": 0.0002},
    )
    fitted = (
        "modulation",
        "row_time_s",
    )
    settles = "frames at the shortest exposure in rolling mode"
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source="engineering prior; refined on a real rig")
    frequency_hz: float = parameter(100.0, "Hz", 20.0, 100000.0, source="engineering prior; refined on a real rig")
    row_time_s: float = parameter(2e-05, "s", 1e-07, 0.01, source="time from one row to the next")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the light averaged over the phase: unchanged."""
        return signal

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the light of one frame at a random phase."""
        left = np.sinc(self.frequency_hz * context.settings.exposure_s)
        turns = self.frequency_hz * self.row_time_s * context.geometry.y_px + rng.random()
        return cast(
            Signal, (signal * (1.0 + self.modulation * left * np.cos(2.0 * np.pi * turns))).astype(signal.dtype)
        )

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the bands split into what a tile shares and what differs between its rows."""
        left = np.square(self.modulation * np.sinc(self.frequency_hz * context.settings.exposure_s)) / 2.0
        height: Any = getattr(context, "tile_height", 1.0)
        shared = np.square(np.sinc(self.frequency_hz * self.row_time_s * height))
        band = left * np.square(before.mean)
        common, rows = before.common_variance + band * shared, before.row_variance + band * (1.0 - shared)
        return replace(after, common_variance=common, row_variance=rows)
