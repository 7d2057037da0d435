"""Single pixels with a large dark current."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.chain.unsteady_pixels import EXPONENTIAL, EXPONENTIAL_SHARES, share_unsteady
from simulators.effects.base import ELECTRONS, PRIOR, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, gain_of, well_e
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class HotPixels(KeepsMean, CatalogueEffect):
    """Adds thermal electrons to a share of the pixels, exponentially distributed about a mean rate.

    Source: CMOS datasheets; the share doubles every few kelvin with the dark current.
    """

    name = "hot_pixels"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "shot_noise"
    where = "exposure_s"
    block = "outliers"
    trials = (
        {"share": 0.001, "rate_e_per_s": 100.0},
        {"share": 0.001, "rate_e_per_s": 1000.0},
        {"share": 0.01, "rate_e_per_s": 300.0},
    )
    fitted = ("share", "rate_e_per_s")
    heated = "rate_e_per_s"
    settles = "dark frames at the longest exposure, warm"
    share: float = parameter(0.0, "1", 0.0, 0.2, source=PRIOR)
    rate_e_per_s: float = parameter(300.0, "e- s-1", 1.0, 10000000.0, source="mean rate of a hot pixel")
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the rate holds at")  # noqa: N815
    doubling_K: float = parameter(7.0, "K", 2.0, 30.0, source="silicon: 6 to 8 K")  # noqa: N815

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        fixed = context.fixed_rng(self.name)
        hot = fixed.random(signal.shape) < self.share
        rate = fixed.exponential(1.0, signal.shape)
        return cast(Signal, (signal + hot * rate * self.electrons(context)).astype(signal.dtype))

    def electrons(self, context: ExposureContext) -> Any:
        """Return the mean thermal electrons of a hot pixel."""
        return self.rate_e_per_s * self.warmed(context) * context.settings.exposure_s

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the numbers of pixels that stand out (by 6 sigmas of a time mean), or are unsteady.

        What leaks scatters, too: the shot noise of its charge. A full pixel does not.
        """
        frames: Any = getattr(context, "frames", 1.0)
        read = context.camera.read_noise_e or 3.0
        noise = np.sqrt((np.maximum(before.mean, 0.0) + read**2) / frames)
        standing_out = np.exp(-6.0 * noise / np.maximum(self.electrons(context), 1e-12))
        pixels: Any = getattr(context, "tile_pixels", 1.0)
        leak = np.asarray(self.electrons(context))[..., None] * EXPONENTIAL
        scatters = share_unsteady(np.asarray(frames)[..., None], 1.0 + leak / (frames * noise**2)[..., None])
        restless = (scatters * (leak < self._full_e(context)) * EXPONENTIAL_SHARES).sum(axis=-1)

        def count(shares: Any) -> Any:
            return (self.share * shares * pixels).mean(axis=-1, keepdims=True).sum(axis=-2, keepdims=True)

        return after.changed(outliers=before.outliers + count(standing_out), unsteady=before.unsteady + count(restless))

    def _full_e(self, context: ExposureContext) -> Any:
        """Return the charge that fills the converter's range or the well, with one more axis."""
        camera = context.camera
        codes_e = (2.0**camera.bit_depth - 1.0) * (camera.conversion_gain_e_per_dn or np.inf) / gain_of(context)
        return np.minimum(codes_e, well_e(context))[..., None]
