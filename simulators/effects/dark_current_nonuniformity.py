"""Dark currents that differ from pixel to pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np
from scipy.special import ndtr

from simulators.chain.unsteady_pixels import share_unsteady
from simulators.effects.base import ELECTRONS, PRIOR, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect, dark_exposures_vary, dark_temperatures_c
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_USUAL_DOUBLING_K: Final = 7.0  # silicon: 6 to 8 K
_VARYING_K: Final = 2.0  # by which darks must differ to tell a law
_LEAST_E: Final = 1e-12  # a pattern that is none
_SURELY: Final = 9.0  # sigmas of the leak's logarithm below which less than 1e-18 of the pixels lie
_EDGES: Final = np.arange(-16, 25) / 4.0
_SIGMAS: Final = 0.5 * (_EDGES[1:] + _EDGES[:-1])  # of the leak's logarithm
_SHARES: Final = np.diff(ndtr(_EDGES))  # share of the pixels with each
_SMOOTH: Final = ("rise_x", "rise_y", "bend_x", "bend_y")
_THIRD: Final = 1.0 / 3.0  # mean of x² from −1 to 1


@dataclass(frozen=True)
class DarkCurrentNonuniformity(UnitSlope, CatalogueEffect):
    """Adds to each pixel a fixed share of thermal electrons: S grows by p·t·2^((T − T₀)/T_d), p varies by s.

    p may rise and bend over the sensor, too: by s·(a·x + b·y + c·(x² − ⅓) + d·(y² − ⅓)), x and y from −1 to 1 over
    its longer side. Generation centres are not spread evenly over a wafer, and edges have more of them.

    The pattern is log-normal less its mean: a few pixels leak much more than the others, and stand out as hot pixels.
    It has no mean, which is the dark current's. Only clipping moves the mean: no pixel holds less than nothing.
    Pixels that stand out in the darks are left out of all tiles.

    Source: EMVA Standard 1288, release 4.0, DCNU; the tail as seen in CMOS datasheets; Widenhorn et al. (2002), Proc.
    SPIE 4669, 193: what differs between pixels is generation in the depletion region (doubling in 7 to 8 K), in
    addition to a diffusion current that all share (3 to 5 K). A KAF-1001E's darks of 300 s at 0 °C rise by 2 % down
    the rows and by 2 % from the middle column to both sides. They rise as slowly with the temperature as the pattern
    does.
    """

    name = "dark_current_nonuniformity"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "shot_noise"
    last_in_place = True  # a pixel is not empty where other leaks fill it
    where = "exposure_s"
    block = "spatial"
    acts_by_square = True
    trials = ({"sigma_e_per_s": 1.0}, {"sigma_e_per_s": 10.0})
    fitted = ("sigma_e_per_s", "shape")
    heated = "sigma_e_per_s"
    settles = "dark frames at two long exposures"
    sigma_e_per_s: float = parameter(0.0, "e- s-1", 0.0, 100000.0, source=PRIOR)
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the figure holds at")  # noqa: N815
    doubling_K: float = parameter(_USUAL_DOUBLING_K, "K", 2.0, 30.0, source="silicon: 4.5 to 8 K")  # noqa: N815
    shape: float = parameter(0.5, "1", 0.05, 1.2, source="standard deviation of the leak's logarithm; CMOS: 0.3 to 0.8")
    rise_x: float = parameter(0.0, "1", -10.0, 10.0, source="shares of the pattern; 0.05 in a KAF-1001E")
    rise_y: float = parameter(0.0, "1", -10.0, 10.0, source="the same from top to bottom")
    bend_x: float = parameter(0.0, "1", -10.0, 10.0, source="the same from the middle to both sides")
    bend_y: float = parameter(0.0, "1", -10.0, 10.0, source="the same to top and bottom")

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the patterns from which a search begins: darks of several temperatures determine their doubling."""
        known = dark_temperatures_c(context)
        varies = known.size > 0 and float(np.ptp(known)) > _VARYING_K
        own = _USUAL_DOUBLING_K + 0.2 if varies else _USUAL_DOUBLING_K
        return tuple(start.with_parameters(doubling_K=own) for start in super().starts(context))

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the doubling only where it is not the usual one."""
        doubling = () if self.doubling_K == _USUAL_DOUBLING_K else ("doubling_K",)
        return (*self.fitted, *doubling, *(_SMOOTH if self._is_uneven() else ()))

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the pattern that rises and bends over the sensor: seen at one exposure, any uneven black is that."""
        if self._is_uneven() or not dark_exposures_vary(context):
            return ()
        return (self.with_parameters(**dict.fromkeys(_SMOOTH, 0.02)),)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        pattern = np.maximum(self.electrons(context), _LEAST_E)
        signal = signal + self._smooth(context) * pattern
        average, spread = self._lognormal()
        emptied = average - signal * spread / pattern  # leaks, over their median, that would leave less than nothing
        found = signal
        if np.max(emptied) > math.exp(-_SURELY * self.shape):  # else no pixel would be, to rounding
            share, held = self._above(emptied)
            found = signal * share + (held - average * share) * pattern / spread
        if getattr(context, "frames", None) is not None:
            found = found - self._left_out(signal, context) * pattern
        return cast(Signal, found.astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with this camera's pattern of leaks; never below zero."""
        tail = np.exp(self.shape * context.fixed_rng(self.name).standard_normal(signal.shape))
        average, spread = self._lognormal()
        leak = (tail - average) / spread + self._smooth(context)
        leaked = np.maximum(signal + leak * self.electrons(context), 0.0)
        return cast(Signal, leaked.astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        (above,) = self._above(self._standing_out(before.mean, context, before.spatial_variance), powers=1)
        pixels: Any = getattr(context, "tile_pixels", 1.0)

        def count(shares: Any) -> Any:
            return (shares * pixels).mean(axis=-1, keepdims=True).sum(axis=-2, keepdims=True)

        return after.changed(
            outliers=before.outliers + count(above),
            unsteady=before.unsteady + count(self._restless(before.mean, after.mean, context)),
        )

    def _is_uneven(self) -> bool:
        return any(getattr(self, name) for name in _SMOOTH)

    def _smooth(self, context: ExposureContext) -> Any:
        """Return by how many of its standard deviations the pattern is higher in some place of the sensor."""
        if not self._is_uneven():
            return 0.0
        x, y = context.geometry.sensor_xy()
        rise = self.rise_x * x + self.rise_y * y
        return rise + self.bend_x * (np.square(x) - _THIRD) + self.bend_y * (np.square(y) - _THIRD)

    def _standing_out(self, signal: Signal, context: ExposureContext, spatial_variance: Any = 0.0) -> Any:
        """Return the leak over its median from which on a pixel stands out by more than 6 robust sigmas."""
        frames: Any = getattr(context, "frames", 1.0)
        read2 = (context.camera.read_noise_e or 3.0) ** 2
        noise2 = (np.maximum(signal, 0.0) + read2) / frames + spatial_variance
        pattern = np.maximum(self.electrons(context), _LEAST_E)
        _, spread = self._lognormal()
        robust2 = np.square(self.shape / spread * pattern)  # what the median deviation of the body gives
        return 1.0 + spread * 6.0 * np.sqrt(noise2 + robust2) / pattern

    def _restless(self, signal: Signal, kept: Signal, context: ExposureContext) -> Any:
        """Return the share of the pixels whose charge scatters far more than what is kept of their tile."""
        frames: Any = np.asarray(getattr(context, "frames", 1.0))
        read2 = (context.camera.read_noise_e or 3.0) ** 2
        average, spread = self._lognormal()
        leak = (np.exp(self.shape * _SIGMAS) - average) / spread
        noise2 = np.maximum(signal[..., None] + leak * np.asarray(self.electrons(context))[..., None], 0.0) + read2
        of_tile2 = np.maximum(kept, 0.0) + read2
        return (share_unsteady(frames[..., None], noise2 / of_tile2[..., None]) * _SHARES).sum(axis=-1)

    def _left_out(self, signal: Signal, context: ExposureContext) -> Any:
        """Return by how many s the mean falls where a series of captures leaves out what stands out in any dark one."""
        share, held = self._above(self._first_left_out(signal, context))
        average, spread = self._lognormal()
        return (held - average * share) / (1.0 - share) / spread

    def _first_left_out(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the leak over its median from which on a series of captures leaves a pixel out."""
        settings: Any = context.settings
        limit = self._standing_out(signal, context)
        dark = np.where(np.broadcast_to(settings.is_dark, np.shape(limit)), limit, np.inf)
        return np.minimum(limit, np.min(dark, axis=-3, keepdims=True))

    def _above(self, leak: Any, powers: int = 2) -> tuple[Any, ...]:
        """Return the share of the pixels above a leak over the median, and the sums of leaks and squares, per pixel."""
        sigmas, s = np.log(np.maximum(leak, 1e-300)) / self.shape, self.shape
        return tuple(math.exp((n * s) ** 2 / 2) * ndtr(n * s - sigmas) for n in range(powers))

    def _lognormal(self) -> tuple[float, float]:
        """Return mean and standard deviation of the leak over its median."""
        square = self.shape**2
        return math.exp(square / 2), math.sqrt((math.exp(square) - 1.0) * math.exp(square))

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> Any:
        whole = np.square(self.electrons(context))
        if getattr(context, "frames", None) is None:
            return whole
        average, spread = self._lognormal()
        share, held, square = self._above(self._first_left_out(signal, context), powers=3)
        kept = 1.0 - share
        left = (average**2 + spread**2 - square) / kept - np.square((average - held) / kept)
        return whole * left / spread**2

    def pattern_e(self, context: ExposureContext) -> Any:
        return self.electrons(context)

    def excess_kurtosis(self) -> float:
        """Return that of a log-normal leak: w⁴ + 2w³ + 3w² − 6 for w = exp(shape²)."""
        w = math.exp(self.shape**2)
        return w**4 + 2.0 * w**3 + 3.0 * w**2 - 6.0

    def electrons(self, context: ExposureContext) -> Any:
        """Return the pattern's standard deviation in electrons."""
        return self.sigma_e_per_s * self.warmed(context) * context.settings.exposure_s
