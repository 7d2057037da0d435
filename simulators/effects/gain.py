"""From electrons to digital numbers, and errors of the gain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np

from radiometer.data import CameraDescription
from radiometer.units import gain_factor
from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, Effect, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Scaling
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ConversionGain(Effect):
    """Scales electrons to DN of the camera's native bit depth: y = S·10^(g/20)/c, so K = 10^(g/20)/c in DN/e-.

    Source: EMVA Standard 1288, release 4.0, equation (5).
    """

    name = "conversion_gain"
    stage = Stage.READOUT
    unit_in = ELECTRONS
    unit_out = DIGITAL_NUMBER
    conversion_gain_e_per_dn: float = parameter(2.6, "e- DN-1", 1e-4, 1e4, source="datasheet, at 0 dB")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.slope(signal, context)

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return gain_factor(context.settings.gain_db) / self.conversion_gain_e_per_dn


@dataclass(frozen=True)
class ConversionGainError(CatalogueEffect):
    """Scales electrons by 1 + e behind the noise: the photon-transfer slope is off by e.

    A fit lowers the responsivity by 1 + e, for the mean is measured. Shot noise variance then grows by 1 + e, read
    noise variance by (1 + e)², and the full well ends at 1 + e times as many DN.

    Source: EMVA Standard 1288, release 4.0, equation (14); typical 2 to 10 %.
    """

    name = "conversion_gain_error"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "variance"
    trials = (
        {"error_rel": 0.05, "read_share": 1.0},
        {"error_rel": -0.05, "read_share": 1.0},
        {"error_rel": 0.2, "read_share": 1.0},
        {"error_rel": 0.05, "read_share": 0.0},
        {"error_rel": -0.05, "read_share": 0.0},
    )
    fitted = ("error_rel",)
    settles = "a photon-transfer series over 1.5 decades of signal"
    error_rel: float = parameter(0.0, "1", -0.5, 2.0, source="engineering prior; refined on a real rig")
    read_share: float = parameter(
        1.0, "1", 0.0, 1.0, source="1 where the read noise is stated in electrons, 0 where in DN"
    )

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal * (1.0 + self.error_rel)).astype(signal.dtype))

    def responsivity_taken(self) -> float:
        """Return 1 + e: a fit lowers the responsivity by it, for the mean is measured."""
        return 1.0 + self.error_rel

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 + self.error_rel

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the share of the read noise that is stated in DN, and does not grow."""
        read_e2 = (context.camera.read_noise_e or 0.0) ** 2  # where none is stated it is fitted, and is none's share
        in_dn = (1.0 - self.read_share) * read_e2
        return after.changed(variance=after.variance - in_dn * ((1.0 + self.error_rel) ** 2 - 1.0))

    def remark(self, camera: CameraDescription, u: Mapping[str, float | None]) -> str:
        """Return the electrons per DN that are stated and those that the noise shows."""
        stated, relative = camera.conversion_gain_e_per_dn, u.get("error_rel")
        if stated is None or relative is None:
            return ""
        true_gain = stated / (1.0 + self.error_rel)
        true_gain_u = true_gain * relative / (1.0 + self.error_rel)
        return f"gain: stated {stated:.4g} e⁻/DN, the noise says {true_gain:.4g} ± {true_gain_u:.2g}"


@dataclass(frozen=True)
class GainStepError(Scaling):
    """Scales by the error of the gain: y' = y·10^(g·e/20)·(1 + table(g)).

    The law serves a constant error per dB; the table (linear between its gains) any other.

    Source: datasheets state 0.2 to 2 % per step.
    """

    name = "gain_step_error"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    before = "black_level"
    where = "gain_db"
    block = "mean"
    trials = ({"error_rel": 0.01}, {"error_rel": -0.01})
    fitted = ("error_rel",)
    varies = "gain_db"
    settles = "every gain step at two light levels, twice each"
    error_rel: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")
    gains_db: tuple[float, ...] = parameter((), "dB", -20.0, 100.0, source="gains at which the table holds an error")
    errors_rel: tuple[float, ...] = parameter((), "1", -0.5, 0.5, source="relative error at these gains")

    def factor(self, context: ExposureContext) -> Any:
        gain_db = np.asarray(context.settings.gain_db)
        law = 10.0 ** (gain_db * self.error_rel / 20.0)
        return law * (1.0 + np.interp(gain_db, self.gains_db, self.errors_rel)) if self.gains_db else law

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the table over the gains in use, which covers every law; 0 dB is exact by definition."""
        steps = np.unique(np.asarray(context.settings.gain_db))
        if not 3 <= steps.size <= 16:
            return ()
        return (cls(gains_db=tuple(steps.tolist()), errors_rel=(0.0,) * steps.size),)

    def free(self) -> tuple[str, ...]:
        if not self.gains_db:
            return ("error_rel",)
        return tuple(f"errors_rel[{index}]" for index in range(1, len(self.gains_db)))
