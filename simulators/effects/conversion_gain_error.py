"""A conversion gain that is not the declared one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from radiometer.data import CameraDescription
from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, declared_dark_e
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ConversionGainError(CatalogueEffect):
    """Scales electrons by 1 + e behind the noise: the photon-transfer slope is off by e.

    Tiles are compared at the measured level, for a fit gives the lost mean back to the responsivity. There the mean
    stays; shot noise variance grows by 1 + e and read noise variance by (1 + e)².

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
        """Return the electrons as the converter counts them."""
        return cast(Signal, (signal * (1.0 + self.error_rel)).astype(signal.dtype))

    def responsivity_taken(self) -> float:
        """Return 1 + e: in the fit the mean stays, and the responsivity has it."""
        return 1.0 + self.error_rel

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1 + e."""
        return 1.0 + self.error_rel

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments at the mean that was there before."""
        error, factor = self.error_rel, 1.0 + self.error_rel
        shot = np.maximum(before.mean, 0.0)
        dark = declared_dark_e(context)  # their number is not in question, unlike that of the light's
        read2 = (before.variance - shot) * (1.0 + self.read_share * (factor**2 - 1.0))
        return replace(
            before, mean=before.mean + error * dark, variance=shot * factor + dark * (factor**2 - factor) + read2
        )

    def remark(self, camera: CameraDescription, u: Mapping[str, float | None]) -> str:
        """Return the electrons per DN that are stated and those that the noise shows."""
        stated, relative = camera.conversion_gain_e_per_dn, u.get("error_rel")
        if stated is None or relative is None:
            return ""
        told = stated / (1.0 + self.error_rel)
        told_u = told * relative / (1.0 + self.error_rel)
        return f"gain: stated {stated:.4g} e-/DN, the noise says {told:.4g} ± {told_u:.2g}"
