"""Flicker that a rolling shutter turns into bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self, cast

import numpy as np

from simulators.effects.base import PRIOR, RADIANCE, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_START: Final = 0.02  # a fit is linear in its square: any size begins
_FREQUENCIES_HZ: Final = np.geomspace(100.0, 4000.0, 12)
_MOST_PERIODS: Final = 48.0  # per frame, of waves that tiles still resolve
_ROWS_PER_PERIOD: Final = 8.0  # a wave of fewer rows cannot be separated from noise of rows
_ROW_TIMES_S: Final = (1e-6, 3e-4)  # of CMOS sensors: 1 µs to 0.3 ms
_SHIFTS: Final = np.linspace(-0.5, 0.5, 21)  # periods per frame
_NEARBY_HZ: Final = np.arange(60.0, 4500.0, 20.0)  # no lobe over the exposures slips through


@dataclass(frozen=True)
class RollingShutterBanding(KeepsMean, CatalogueEffect):
    """Modulates light from row to row: L' = L·(1 + m·sinc(f·t)·cos(2π·f·t_row·row + φ)), φ new in every frame.

    Source: mains or dimming flicker under a rolling shutter; only with row-by-row exposure.
    """

    name = "rolling_shutter_banding"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "image_y"
    block = "bands"
    also = ("row_temporal",)
    acts_by_square = True
    log_prior_odds = -3.0
    prior_reason = "one of hundreds of waves fits by chance"
    trials = ()
    fitted = ("modulation", "frequency_hz", "row_time_s")
    settles = "frames at the shortest exposure in rolling mode"
    essential = ("row_time_s",)  # without it whole frames flicker, whatever shakes them
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source=PRIOR)
    frequency_hz: float = parameter(100.0, "Hz", 20.0, 100000.0, source=PRIOR)
    row_time_s: float = parameter(2e-05, "s", 1e-07, 0.01, source="time from one row to the next")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the light of one frame at a random phase."""
        left = np.sinc(self.frequency_hz * context.settings.exposure_s)
        turns = self.frequency_hz * self.row_time_s * context.geometry.y_px + rng.random()
        return cast(
            Signal, (signal * (1.0 + self.modulation * left * np.cos(2.0 * np.pi * turns))).astype(signal.dtype)
        )

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        left = np.square(self.modulation * np.sinc(self.frequency_hz * context.settings.exposure_s)) / 2.0
        bands = before.band_variance + left * np.square(before.mean)
        return after.changed(band_variance=bands, band_frequency=self.frequency_hz * self.row_time_s)

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return waves of up to 48 periods per frame, at least eight rows each, at row times that sensors have."""
        height = context.geometry.sensor_height
        periods = (0.06, 0.12, 0.25, *np.arange(0.5, min(_MOST_PERIODS, height / _ROWS_PER_PERIOD), 0.5).tolist())
        rows = ((p / height / f, f) for p in periods for f in _FREQUENCIES_HZ.tolist())
        chosen = [(row_s, f) for row_s, f in rows if _ROW_TIMES_S[0] < row_s < _ROW_TIMES_S[1]]
        return tuple(cls(_START, f, row_s) for row_s, f in chosen)

    def nearby(self, rows: int, turn: int) -> tuple[Self, ...]:
        """Return waves of the same frequency but others along the rows; in the second turn the reverse."""
        per_row = self.frequency_hz * self.row_time_s
        if turn == 0:
            found = [(self.frequency_hz, per_row + shift / rows) for shift in _SHIFTS.tolist()]
        else:
            found = [(hertz, per_row) for hertz in _NEARBY_HZ.tolist()]
        known = next(entry for entry in self.parameters() if entry.name == "row_time_s")
        return tuple(
            self.with_parameters(frequency_hz=hertz, row_time_s=step / hertz)
            for hertz, step in found
            if known.low <= step / hertz <= known.high
        )
