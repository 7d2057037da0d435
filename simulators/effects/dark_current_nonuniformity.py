"""Dark currents that differ from pixel to pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final, Self, cast

import numpy as np
from scipy.special import ndtr

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, temperature_varies, warmer_k
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_USUAL_DOUBLING_K: Final = 7.0


@dataclass(frozen=True)
class DarkCurrentNonuniformity(CatalogueEffect):
    """Adds to each pixel a fixed share of thermal electrons: S grows by p·t·2^((T − T₀)/T_d), p varies by s.

    The pattern is log-normal less its mean: a few pixels leak much more than the others, and stand out as hot pixels.
    These are left out of a tile's mean and no pixel leaks less than nothing, so that the mean moves by a share m of s.

    Source: EMVA Standard 1288, release 4.0, DCNU; the tail as seen in CMOS datasheets.
    """

    name = "dark_current_nonuniformity"
    stage = Stage.ELECTRONS
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    before = "shot_noise"
    where = "exposure_s"
    block = "spatial"
    acts_by_square = True
    trials = (
        {"sigma_e_per_s": 1.0},
        {"sigma_e_per_s": 10.0},
    )
    fitted = ("sigma_e_per_s", "mean_share", "shape")
    settles = "dark frames at two long exposures"
    endless = ("shape",)  # a log-normal of small shape is a normal one
    sigma_e_per_s: float = parameter(0.0, "e- s-1", 0.0, 100000.0, source="engineering prior; refined on a real rig")
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the figure holds at")  # noqa: N815
    doubling_K: float = parameter(_USUAL_DOUBLING_K, "K", 2.0, 30.0, source="silicon: 6 to 8 K")  # noqa: N815
    mean_share: float = parameter(
        0.0, "1", -0.5, 0.5, source="what clipping at zero and masked pixels leave of the mean"
    )
    shape: float = parameter(0.5, "1", 0.05, 1.2, source="standard deviation of the leak's logarithm; CMOS: 0.3 to 0.8")

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the pattern that doubles within kelvins of its own."""
        if self.doubling_K != _USUAL_DOUBLING_K or not temperature_varies(context):
            return ()
        return (self.with_parameters(doubling_K=_USUAL_DOUBLING_K + 0.2),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the doubling only where it is not the usual one."""
        return self.fitted if self.doubling_K == _USUAL_DOUBLING_K else (*self.fitted, "doubling_K")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the signal of the pixels that count."""
        return cast(Signal, (signal + self.mean_share * self.electrons(context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with this camera's pattern of leaks; never below zero."""
        tail = np.exp(self.shape * context.fixed_rng(self.name).standard_normal(signal.shape))
        average, spread = self._lognormal()
        leaked = np.maximum(signal + (tail - average) / spread * self.electrons(context), 0.0)
        return cast(Signal, leaked.astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the number of pixels that stand out by more than 6 robust sigmas."""
        frames: Any = getattr(context, "frames", 1.0)
        read2 = (context.camera.read_noise_e or 3.0) ** 2
        noise2 = (np.maximum(before.mean, 0.0) + read2) / frames + before.spatial_variance
        pattern = np.maximum(self.electrons(context), 1e-12)
        _, spread = self._lognormal()
        robust2 = np.square(self.shape / spread * pattern)  # what the median deviation of the body tells
        limit = 6.0 * np.sqrt(noise2 + robust2) / pattern
        above = ndtr(-np.log(1.0 + spread * limit) / self.shape)
        pixels: Any = getattr(context, "tile_pixels", 1.0)
        count = (above * pixels).mean(axis=2, keepdims=True).sum(axis=1, keepdims=True)
        return replace(after, outliers=before.outliers + count)

    def _lognormal(self) -> tuple[float, float]:
        """Return mean and standard deviation of the leak over its median."""
        square = self.shape**2
        return math.exp(square / 2), math.sqrt((math.exp(square) - 1.0) * math.exp(square))

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the pattern's variance in e-²."""
        return np.square(self.electrons(context))

    def pattern_e(self, context: ExposureContext) -> Any:
        """Return the pattern's standard deviation in electrons."""
        return self.electrons(context)

    def excess_kurtosis(self) -> float:
        """Return that of a log-normal leak: w⁴ + 2w³ + 3w² − 6 for w = exp(shape²)."""
        w = math.exp(self.shape**2)
        return w**4 + 2.0 * w**3 + 3.0 * w**2 - 6.0

    def electrons(self, context: ExposureContext) -> Any:
        """Return the pattern's standard deviation in electrons."""
        warmer = 2.0 ** (warmer_k(context, self.reference_C) / self.doubling_K)
        return self.sigma_e_per_s * warmer * context.settings.exposure_s
