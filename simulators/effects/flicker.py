"""Light that flickers: modulation averaged over an exposure, or seen by its rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from simulators.effects.base import RADIANCE, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_HARMONICS: Final = 12  # the thirteenth of a square wave has 0.5 % of its variance


class Flicker(KeepsMean, CatalogueEffect):
    """Modulates light by m at a frequency f, at a new phase in every frame.

    A duty of 0 is a sine; otherwise a square wave that is on for that share of the period. Each harmonic of amplitude c
    is averaged over an exposure t to c·sinc(k·f·t), and has a variance of c²/2 from frame to frame.
    """

    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "exposure_s"
    block = "common"
    acts_by_square = True
    modulation: float
    frequency_hz: float
    duty: float = 0.0

    def _harmonics(self, exposure_s: Any) -> list[tuple[int, Any]]:
        """Return (k, amplitude) of each harmonic after the exposure, for unit modulation."""
        waves = [(1, 1.0)]
        if self.duty > 0:
            orders = range(1, _HARMONICS + 1)
            waves = [(k, 2.0 * float(np.sin(np.pi * k * self.duty)) / (np.pi * k * self.duty)) for k in orders]
        return [(k, c * np.sinc(k * self.frequency_hz * exposure_s)) for k, c in waves]

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the light of one frame that begins at a random phase; never below zero."""
        exposure_s = context.settings.exposure_s
        phase = self.frequency_hz * exposure_s / 2 + rng.random()
        wave = sum(c * np.cos(2.0 * np.pi * k * phase) for k, c in self._harmonics(exposure_s))
        return cast(Signal, (signal * max(0.0, 1.0 + self.modulation * float(wave))).astype(signal.dtype))

    def common_variance(self, signal: Signal, context: ExposureContext) -> Any:
        parts = [0.5 * np.square(c) for _, c in self._harmonics(context.settings.exposure_s)]
        return np.square(self.modulation * signal) * sum(parts[1:], parts[0])


_DIMMING_HZ: Final = np.geomspace(60.0, 4000.0, 36)
_DUTIES: Final = (0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9)  # the usual dimming steps
_COMB: Final = np.geomspace(0.94, 1.06, 9)  # from halfway to one neighbour to halfway to the other


@dataclass(frozen=True)
class PwmFlicker(Flicker):
    """Modulates light: L' = L·(1 + m·flicker(f·t + φ)), φ new in every frame.

    A duty of 0 is a sine; otherwise a square wave of that duty. Over an exposure t sinc(f·t) of it is left.

    Source: LED and backlight dimming, 100 Hz to some kHz.
    """

    name = "pwm_flicker"
    trials = tuple(
        {"modulation": 0.02, "frequency_hz": float(f), "duty": d} for d in (0.0, 0.5, 0.25) for f in _DIMMING_HZ
    )
    fitted = ("modulation", "frequency_hz")
    settles = "many frames at the shortest exposures"
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source="engineering prior; refined on a real rig")
    frequency_hz: float = parameter(200.0, "Hz", 20.0, 100000.0, source="engineering prior; refined on a real rig")
    duty: float = parameter(0.0, "1", 0.0, 0.95, source="0 for a sine")

    def between(self) -> tuple[Self, ...]:
        """Return a dense comb of frequencies.

        Over many periods the light of an exposure depends on the frequency to a small part of a period.
        """
        return tuple(self.with_parameters(frequency_hz=float(self.frequency_hz * factor)) for factor in _COMB)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return tuple(self.with_parameters(duty=duty) for duty in _DUTIES if duty != self.duty)


@dataclass(frozen=True)
class MainsRipple(Flicker):
    """Modulates light at twice the mains frequency: L' = L·(1 + m·sin(2π·f·t + φ)), φ new in every frame.

    Zero for exposures of whole periods (10 ms at 100 Hz, 8.33 ms at 120 Hz).

    Source: rectified mains, 100 or 120 Hz.
    """

    name = "mains_ripple"
    trials = ({"modulation": 0.02, "frequency_hz": 100.0}, {"modulation": 0.02, "frequency_hz": 120.0})
    fitted = ("modulation",)
    settles = "exposures of 9, 10 and 11 ms"
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source="engineering prior; refined on a real rig")
    frequency_hz: float = parameter(100.0, "Hz", 20.0, 1000.0, source="100 or 120 Hz")


_START: Final = 0.02  # a fit is linear in its square: any size begins
_BANDS_HZ: Final = np.geomspace(100.0, 4000.0, 12)
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
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source="engineering prior; refined on a real rig")
    frequency_hz: float = parameter(100.0, "Hz", 20.0, 100000.0, source="engineering prior; refined on a real rig")
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
        rows = ((p / height / f, f) for p in periods for f in _BANDS_HZ.tolist())
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
