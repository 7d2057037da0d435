"""A weak inverted image by reflection between lens surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.surroundings import surroundings_of


@dataclass(frozen=True)
class Ghost(UnitSlope, CatalogueEffect):
    """Adds the picture turned about the axis: E'(x) = E(x) + g·(E ∗ G_σ)(−x); σ is 0 for a sharp ghost.

    Source: double reflection between two lens surfaces.
    """

    name = "ghost"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "image_x"
    block = "mean"
    trials = ({"share": 0.003}, {"share": 0.02})
    fitted = ("share",)
    further = ({"blur": 0.03},)
    settles = "one bright patch moved across the picture"
    share: float = parameter(0.0, "1", -0.02, 0.3, source=PRIOR)
    blur: float = parameter(0.0, "1", 0.0, 0.3, source="σ over the longer side: ghosts are seldom in focus")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        turned = surroundings_of(context).reflected(signal, self.blur)
        return cast(Signal, (signal + self.share * turned).astype(signal.dtype))
