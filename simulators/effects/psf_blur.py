"""A picture that is not sharp, at any f-number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.pixel_mixing import blur_edge_share, blur_image
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class PsfBlur(UnitSlope, CatalogueEffect):
    """Blurs the picture with a Gaussian of standard deviation σ.

    Source: aberrations and pixel aperture.
    """

    name = "psf_blur"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "image_x"
    block = "edge"
    trials = tuple({"sigma_px": sigma} for sigma in (0.25, 0.3, 0.35, 0.42, 0.5, 0.7, 1.0))
    fitted = ("sigma_px",)
    settles = "an edge at several f-numbers"
    sigma_px: float = parameter(0.0, "px", 0.0, 50.0, source=PRIOR)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the blurred picture; tiles keep their distance from edges and stay as they are."""
        return blur_image(signal, self.sigma_px, context)

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        return after.changed(edge_share=before.edge_share + blur_edge_share(np.full((1, 1, 1), self.sigma_px)))
