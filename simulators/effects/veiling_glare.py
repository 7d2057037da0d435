"""Light that the lens scatters over the whole picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.surroundings import surroundings_of


@dataclass(frozen=True)
class VeilingGlare(CatalogueEffect):
    """Spreads a share of all light evenly: E' = (1 − v)·E + v·mean(E).

    Source: ISO 9358; typical 0.2 to 3 %.
    """

    name = "veiling_glare"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "patch_level"
    block = "mean"
    trials = (
        {"share": 0.005},
        {"share": 0.02},
    )
    fitted = ("share",)
    settles = "the same patches with a bright and with a dark surround"
    share: float = parameter(0.0, "1", -0.05, 0.5, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return irradiance with the veil."""
        veil = self.share * surroundings_of(context).frame_mean(signal)
        return cast(Signal, (signal * (1.0 - self.share) + veil).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1 − v."""
        return 1.0 - self.share
