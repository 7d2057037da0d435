"""A weak inverted image by reflection between lens surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self, cast

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.surroundings import surroundings_of


@dataclass(frozen=True)
class Ghost(CatalogueEffect):
    """Adds the picture turned about the axis: E'(x) = E(x) + g·(E ∗ G_σ)(−x); σ is 0 for a sharp ghost.

    Source: double reflection between two lens surfaces.
    """

    name = "ghost"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "image_x"
    block = "mean"
    trials = (
        {"share": 0.003},
        {"share": 0.02},
    )
    fitted = ("share",)
    settles = "one bright patch moved across the picture"
    share: float = parameter(0.0, "1", -0.02, 0.3, source="engineering prior; refined on a real rig")
    blur: float = parameter(0.0, "1", 0.0, 0.3, source="σ over the longer side: ghosts are seldom in focus")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return irradiance with the ghost."""
        turned = surroundings_of(context).reflected(signal, self.blur)
        return cast(Signal, (signal + self.share * turned).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the ghost out of focus."""
        return () if self.blur else (self.with_parameters(blur=0.03),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the blur only where there is one."""
        return ("share", "blur") if self.blur else ("share",)
