"""A picture out of focus: the sharper, the smaller the aperture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, f_number_varies
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.pixel_mixing import blur_edge_share, blur_image
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class Defocus(CatalogueEffect):
    """Blurs the picture with a Gaussian of standard deviation c/N.

    Source: geometrical optics: the circle of confusion is proportional to the aperture.
    """

    name = "defocus"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = "f_number"
    block = "edge"
    trials = (
        {"sigma_f1_px": 1.0},
        {"sigma_f1_px": 2.0},
        {"sigma_f1_px": 6.0},
    )
    fitted = ("sigma_f1_px",)
    settles = "an edge at several f-numbers"
    sigma_f1_px: float = parameter(0.0, "px", 0.0, 200.0, source="standard deviation that f/1 would have")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the blurred picture; tiles keep their distance from edges and stay as they are."""
        return blur_image(signal, self._sigma(context), context)

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what blurs across an edge."""
        return replace(after, edge_share=before.edge_share + blur_edge_share(self._sigma(context)))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the f-number varies."""
        return f_number_varies(context)

    def _sigma(self, context: ExposureContext) -> Any:
        known: Any = 4.0 if context.f_number is None else context.f_number
        return self.sigma_f1_px / np.asarray(known)
