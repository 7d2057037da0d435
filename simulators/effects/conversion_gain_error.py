"""A conversion gain that is not the declared one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from radiometer.data import CameraDescription
from simulators.effects.base import ELECTRONS, PRIOR, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


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
    error_rel: float = parameter(0.0, "1", -0.5, 2.0, source=PRIOR)
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
