"""Light that the lens scatters around each point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.surroundings import surroundings_of
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class StrayLightKernel(CatalogueEffect):
    """Spreads a share of the light over a wide Gaussian: E' = (1 − v)·E + v·(E ∗ G_σ).

    Source: the far tail of a point-spread function; σ a tenth of the picture and more.
    """

    name = "stray_light_kernel"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "image_x"
    block = "mean"
    trials = (
        {"share": 0.01, "radius": 0.05},
        {"share": 0.01, "radius": 0.08},
        {"share": 0.01, "radius": 0.12},
        {"share": 0.01, "radius": 0.2},
        {"share": 0.01, "radius": 0.3},
    )
    fitted = ("share", "radius", "edge_share")
    settles = "one bright patch with several sizes of surround"
    essential = ("radius",)  # a kernel of any width is any glare
    share: float = parameter(0.0, "1", -0.05, 0.5, source="engineering prior; refined on a real rig")
    radius: float = parameter(0.1, "1", 0.02, 1.0, source="sigma as a fraction of the longer side")
    edge_share: float = parameter(
        0.05, "1", 0.0, 0.4, source="part of the kernel in the last line before an edge, over the patch's own mean"
    )

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return irradiance with the scattered light."""
        wide = surroundings_of(context).spread(signal, self.radius)
        return cast(Signal, (signal * (1.0 - self.share) + self.share * wide).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1 − v."""
        return 1.0 - self.share

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what the kernel carries across an edge, which hangs on where the patch ends."""
        return replace(after, edge_share=before.edge_share + np.full((1, 1, 1), self.share * self.edge_share))
