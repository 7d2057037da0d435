"""A channel of the source for which the camera responds differently."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class SpectralMismatch(Scaling):
    """Scales the share of light that one channel gives: L' = L·(1 + e·share).

    Source: a responsivity stated for one spectrum and used for another.
    """

    name = "spectral_mismatch"
    stage = Stage.SOURCE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "source_level"
    block = "mean"
    trials = (
        {"error_rel": 0.05},
        {"error_rel": -0.05},
    )
    fitted = ("error_rel",)
    settles = "each channel of the source alone"
    error_rel: float = parameter(0.0, "1", -0.9, 5.0, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor; the channel's share of the light stands in `context.extra`."""
        return 1.0 + self.error_rel * context.extra.get("channel_share", 0.0)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the share of a channel is known."""
        return "channel_share" in context.extra
