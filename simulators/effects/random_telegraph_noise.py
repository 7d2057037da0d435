"""Single pixels whose read-out jumps between two levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from scipy.special import ndtr, ndtri

from simulators.chain.unsteady_pixels import EXPONENTIAL, EXPONENTIAL_SHARES, share_restless, share_unsteady
from simulators.effects.base import ELECTRONS, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, gain_of
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_OUTLYING: Final = 6.0  # sigmas of a time mean
_TILES: Final = (np.arange(4) + 0.5) / 4  # places of representative tiles among those of a capture, by noise
# Sigmas by which a count is off one half, for each of these tiles
_FROM_HALF: Final = np.tile(ndtri(0.5 + 0.5 * (np.arange(8) + 0.5) / 8), _TILES.size)


@dataclass(frozen=True)
class RandomTelegraphNoise(KeepsMean, CatalogueEffect):
    """Lets a share of the pixels jump by ±A/2 from frame to frame, either way half the time.

    The heights A are exponentially distributed. One trap in the transistor that reads a pixel holds a charge or not.
    The jump is the same with light or without, at every exposure and gain. Pixels that stand out or are unsteady in a
    dark are left out of all later captures, so that high jumps leave the noise of tiles.

    Source: traps of the source follower are the main noise of dim pictures (Zhang et al. 2016, Chinese Physics B 25,
    070503). They are part of the tail of its distribution (Chao et al. 2019, Sensors 19, 5447). That their heights are
    exponentially distributed is an assumption. Jumps of the dark charge (Hopkins and Hopkinson 1993, IEEE Trans. Nucl.
    Sci. 40, 1567; Bogaerts et al. 2002, ibid. 49, 249) grow with the exposure instead.
    """

    name = "random_telegraph_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "gain_db"
    block = "unsteady"
    also = ("variance", "outliers")
    trials = ({"share": 0.003, "height_e": 20.0}, {"share": 0.03, "height_e": 8.0})
    fitted = ("share", "height_e")
    settles = "many dark frames at the shortest exposure"
    share: float = parameter(0.0, "1", 0.0, 0.1, source="of the pixels: 1e-4 to 1e-1; all have small jumps, as noise")
    height_e: float = parameter(20.0, "e-", 0.5, 10000.0, source="mean height of a jump: 2 to 100 e-")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        fixed = context.fixed_rng(self.name)
        height = (fixed.random(signal.shape) < self.share) * fixed.exponential(self.height_e, signal.shape)
        return cast(Signal, (signal + height * (rng.integers(0, 2, signal.shape) - 0.5)).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        """Return ⟨A²⟩/4 in e-² times the share of the pixels that jump."""
        return 0.5 * self.share * self.height_e**2

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments of the pixels that count, with the numbers of those that stand out and are unsteady."""
        if getattr(context, "frames", None) is None:
            return after
        settings: Any = context.settings
        frames = np.asarray(getattr(context, "frames", 1.0), dtype=np.float64)[..., None]
        white, pattern = _of_frame(before.variance + _of_codes(context)), _of_frame(before.spatial_variance)
        sigma = np.sqrt(white / frames + pattern)
        height = self.height_e * EXPONENTIAL[:, None]  # heights and counts are the last two axes
        high = np.clip(np.rint(0.5 * frames + 0.5 * np.sqrt(frames) * _FROM_HALF), 0.0, frames) / frames
        squares = np.square(height) * high * (1.0 - high) * frames  # their sum about the time mean
        moved = height * (high - 0.5)
        stands = ndtr(moved / sigma - _OUTLYING)
        dark = np.broadcast_to(np.ravel(settings.is_dark), stands.shape[-4])[:, None, None, None]
        calm = np.where(dark, 1.0 - share_restless(frames, 1.0, squares / white), 1.0)
        kept = 1.0 - stands
        kept = kept * _left_by_darks(1.0 - (kept * calm).mean(axis=-1, keepdims=True), context)
        shares = self.share * EXPONENTIAL_SHARES[:, None] / _FROM_HALF.size

        def of_pixels(values: Any) -> Any:
            return (shares * values).sum(axis=(-2, -1))[..., None]

        of_pixel = calm * squares / np.maximum(frames - 1.0, 1.0)
        noise = of_pixels(kept * of_pixel)
        fixed = of_pixels(kept * np.square(moved)) - noise / frames[..., 0]
        of_tile, sigmas = white / (white + noise[..., None]), height / np.sqrt(white)
        both = (share_unsteady(frames, of_tile, sigmas, frames * share) for share in (high, 1.0 - high))
        unsteady = 0.5 * sum(both)
        pixels = np.sum(getattr(context, "tile_pixels", 1.0))
        return after.changed(
            variance=before.variance + noise,
            spatial_variance=before.spatial_variance + fixed,
            outliers=before.outliers + pixels * of_pixels(stands),
            unsteady=before.unsteady + pixels * of_pixels(unsteady),
            uneven_noise=np.hypot(before.uneven_noise, np.sqrt(of_pixels(kept * np.square(of_pixel)))),
        )


def _of_frame(values: Any) -> Any:
    """Return the values of representative tiles, each for all counts, (…, captures, 1, 1, counts)."""
    ordered = np.sort(np.reshape(values, (*np.shape(values)[:-2], -1)), axis=-1)
    chosen = ordered[..., (_TILES * ordered.shape[-1]).astype(np.intp)]
    return np.repeat(chosen, _FROM_HALF.size // _TILES.size, axis=-1)[..., None, None, :]


def _of_codes(context: ExposureContext) -> Any:
    """Return the variance in e-² that rounding to whole codes adds behind."""
    return np.square((context.camera.conversion_gain_e_per_dn or 0.0) / gain_of(context)) / 12.0


def _left_by_darks(found: Any, context: ExposureContext) -> Any:
    """Return the chance that no dark capture before has a pixel left out: they come first, the longest foremost.

    Args:
        found: Chance that a pixel stands out or is unsteady in each capture, (…, captures, 1, heights, 1).
    """
    settings: Any = context.settings
    captures = found.shape[-4]
    dark = np.broadcast_to(np.ravel(settings.is_dark), captures)
    order = np.argsort(np.where(dark, -np.broadcast_to(np.ravel(settings.exposure_s), captures), np.inf), kind="stable")
    stays = np.where(dark[:, None, None, None], 1.0 - found, 1.0)
    ahead = np.ones_like(stays)
    ahead[..., order[1:], :, :, :] = np.cumprod(stays[..., order[:-1], :, :, :], axis=-4)
    return ahead
