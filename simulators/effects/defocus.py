"""A picture out of focus: the sharper, the smaller the aperture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.pixel_mixing import blur_edge_share, blur_image, disc_edge_share, spread_over_disc
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class Defocus(UnitSlope, CatalogueEffect):
    """Blurs the picture with a Gaussian of standard deviation c/N, or in part (e) with an even disc of the same spread.

    The disc's radius is 2·c/N: a point out of focus, were there no aberration and no diffraction.

    Source: geometrical optics: the circle of confusion is proportional to the aperture.
    """

    name = "defocus"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "edge"
    trials = tuple({"sigma_f1_px": sigma} for sigma in (1.0, 0.6, 0.8, 1.4, 2.0, 3.0, 6.0))
    fitted = ("sigma_f1_px",)
    varies = "f_number"
    further = ({"evenness": 0.5},)
    settles = "an edge at several f-numbers"
    sigma_f1_px: float = parameter(0.0, "px", 0.0, 200.0, source="standard deviation that f/1 would have")
    evenness: float = parameter(0.0, "1", 0.0, 1.0, source="0 a Gaussian, 1 the disc of geometrical optics")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        soft = blur_image(signal, self._sigma(context), context)
        if not self.evenness:
            return soft
        disc = spread_over_disc(signal, 2.0 * self._sigma(context), context)
        return cast(Signal, ((1.0 - self.evenness) * soft + self.evenness * disc).astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        sigma = self._sigma(context)
        share = (1.0 - self.evenness) * blur_edge_share(sigma) + self.evenness * disc_edge_share(2.0 * sigma)
        return after.changed(edge_share=before.edge_share + share)

    def _sigma(self, context: ExposureContext) -> Any:
        known: Any = 4.0 if context.f_number is None else context.f_number
        return self.sigma_f1_px / np.asarray(known)
