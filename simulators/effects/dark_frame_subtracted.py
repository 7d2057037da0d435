"""Frames from which a dark frame was subtracted before anybody saw them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np

from radiometer.units import gain_factor
from simulators.effects.base import DIGITAL_NUMBER, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, declared_dark_e
from simulators.effects.clipping import censored_above, censored_below, is_reached, limited, unevenly_limited
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.rounding import rounded
from simulators.effects.tile_moments import TileMoments

_FAR_SIGMAS = 9.0  # above zero, beyond which nothing is cut


@dataclass(frozen=True)
class DarkFrameSubtracted(CatalogueEffect):
    """Subtracts the mean of n dark frames and keeps a pedestal p: y' = max(y − d̄ + p, 0), d̄ in whole codes.

    The darks have the frame's exposure, gain and temperature. What they hold on average goes: black level and dark
    charge as the camera's description has them, and all patterns of the dark. The darks' noise replaces it, and is
    the same in all frames of that setting. It has whole codes of variance s·K²·(σ_r² + μ_d) + (s − s²)/12 before they
    are rounded, s = 1/n, with read noise σ_r and dark electrons μ_d. Each setting has a separate pattern. The highest
    code comes down by what is subtracted, and negative values are cut, pixel by pixel.

    What leaks beyond the description is gone from the mean as well: it shows in the noise alone
    (`dark_current_clamped`). The median of many darks has s = π/(2n); a mean of two is rounded from halves, which
    adds 1/24 DN² more than is stated here.

    Source: Howell (2006), Handbook of CCD Astronomy, 2nd ed., section 4.3 (a calibration frame brings its own noise);
    Janesick (2001), Scientific Charge-Coupled Devices, on removing fixed pattern noise by subtracting frames.
    """

    name = "dark_frame_subtracted"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER
    where = "exposure_s"
    block = "mean"
    also = ("spatial",)
    is_stepwise = True
    essential = ("share",)  # without noise of its own it is a black level taken off
    trials = ({"share": 1.0, "pedestal_dn": 0.0}, {"share": 0.1, "pedestal_dn": 0.0})
    fitted = ("share", "pedestal_dn")
    settles = "dark frames at the shortest and the longest exposure: black level and pattern of both"
    share: float = parameter(1.0, "1", 0.0, 2.0, source="one over the number of darks: 1 (in the camera) to 0.01")
    pedestal_dn: float = parameter(
        0.0, "DN", 0.0, 1.0, source="0, or a round number that keeps noise positive", of_full_scale=True
    )

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return frames of which nothing is kept, and those that keep a small or all of the black level."""
        black = float(np.max(np.nan_to_num(np.asarray(_black_dn(context), dtype=np.float64))))
        pedestals = sorted({0.0, black, 0.5 * black})
        return tuple(cls(share, kept) for kept in pedestals for share in (1.0, 0.1))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the description says what a dark frame holds: black level, read noise and gain."""
        camera = context.camera
        stated = camera.conversion_gain_e_per_dn is not None and camera.read_noise_e is not None
        return stated and bool(np.any(np.nan_to_num(np.asarray(_black_dn(context), dtype=np.float64)) > 0.0))

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the part above zero, not rounded."""
        return cast(Signal, np.maximum(self._lifted(signal, context), 0.0).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        """Return 1, and 0 where all is cut or the converter is full."""
        inside = (self._lifted(signal, context) > 0) & (signal < context.full_scale_dn)
        return cast(Signal, inside.astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the frame less the dark of its setting, which is the same for all frames of it."""
        settings = context.settings
        setting = f"{self.name} {settings.exposure_s} {settings.gain_db} {settings.temperature_c}"
        dice = np.random.default_rng((context.device_seed, zlib.crc32(setting.encode())))
        level, variance = self._mean_of_darks(context)
        dark = np.rint(level + np.sqrt(variance) * dice.standard_normal(signal.shape))
        read = np.minimum(signal, context.full_scale_dn)
        return cast(Signal, np.maximum(read - dark + np.rint(self.pedestal_dn), 0.0).astype(signal.dtype))

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments after subtraction: a pattern more, the highest code lower, no value negative."""
        top = float(context.full_scale_dn)
        if is_reached(before, top):
            before = limited(before, lambda tail: censored_above(tail, top))
        level, pattern2 = self._taken(context)
        shifted = _shifted(before, self.pedestal_dn - level)
        spread = np.sqrt(np.maximum(before.variance, 0.0) + pattern2)
        if float(np.min(shifted.mean - _FAR_SIGMAS * spread)) <= 0.0:
            return _cut(shifted, np.sqrt(pattern2))
        after = shifted.changed(spatial_variance=shifted.spatial_variance + pattern2)
        if not isinstance(after, TileMoments):
            return after
        return after.changed(renewed_variance=after.renewed_variance + pattern2)

    def _lifted(self, signal: Signal, context: ExposureContext) -> Any:
        return np.minimum(signal, context.full_scale_dn) - self._taken(context)[0] + self.pedestal_dn

    def _taken(self, context: ExposureContext) -> tuple[Any, Any]:
        """Return mean and variance from pixel to pixel of the whole codes that are taken off, in DN and DN²."""
        level, variance = np.broadcast_arrays(*map(np.atleast_1d, self._mean_of_darks(context)))
        nothing = np.zeros((1,) * level.ndim)
        codes = rounded(Moments(level, variance, nothing, nothing))
        if np.ndim(context.settings.exposure_s):
            return codes.mean, codes.variance
        return codes.mean[0], codes.variance[0]

    def _mean_of_darks(self, context: ExposureContext) -> tuple[Any, Any]:
        """Return level and variance of the mean of n darks in output DN and DN², before it is rounded itself."""
        gain = gain_factor(context.settings.gain_db) / (context.camera.conversion_gain_e_per_dn or 1.0)
        scale, electrons, read = context.output_scale, declared_dark_e(context), context.camera.read_noise_e or 0.0
        one = np.square(gain * scale) * (read**2 + electrons)
        rounding = max(self.share - self.share**2, 0.0) / 12.0  # of each dark; a single one is in whole codes already
        return (_black_dn(context) + gain * electrons) * scale, self.share * one + rounding


def _shifted(before: Moments, by: Any) -> Moments:
    after = before.changed(mean=before.mean + by)
    return after if before.unrounded is None else after.changed(unrounded=_shifted(before.unrounded, by))


def _cut(shifted: Moments, pattern: Any) -> Moments:
    """Return the moments of values with a pattern, cut at zero pixel by pixel."""

    def shifted_by(moments: Moments, sigmas: float) -> Moments:
        moved = moments.changed(mean=moments.mean + sigmas * pattern)
        return limited(moved, lambda tail: censored_below(tail, 0.0))

    if not isinstance(shifted, TileMoments):
        return unevenly_limited(shifted, shifted_by)
    after = cast(TileMoments, unevenly_limited(shifted.changed(limit_variance=0.0), shifted_by))
    left = after.limit_variance  # all of it: what the cut leaves of the pattern
    return after.changed(limit_variance=shifted.limit_variance, renewed_variance=after.renewed_variance + left)


def _black_dn(context: ExposureContext) -> Any:
    level = context.settings.black_level_dn
    return (context.camera.black_level_dn or 0.0) if level is None else level
