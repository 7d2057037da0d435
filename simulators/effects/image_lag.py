"""Charge that stays behind from the frame before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_REFERENCE_E: Final = 1000.0  # at which a power law releases the plain share
_LEAST_E: Final = 1.0  # a power below 1 is endless at nothing


@dataclass(frozen=True)
class ImageLag(UnitSlope, CatalogueEffect):
    """Adds a share of what the pixel held in the frame before: S' = S + l·S_prev, or less where traps fill up.

    Traps that hold at most 1/c electrons release (1 − exp(−c·l·S_prev))/c; c = 0 is the plain share. Slow traps
    release a further share m of the frame before that one, which a single frame takes to be like the one before. Traps
    of many depths release by a power p: l·S_prev·(S_prev/1000 e-)^(p − 1).

    Each electron that stays by chance makes the remaining charge as noisy as light of as many electrons; what a
    barrier holds back, or a settling output stage, is a fixed share and adds none. The noise is a share of the
    former, 1 as a rule.

    Source: incomplete charge transfer; typical 0.01 to 0.5 %. Traps: first-order filling; of many depths a
    power between a half and 1 (engineering prior). Noise: thinning of a Poisson process.
    """

    name = "image_lag"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "full_well_saturation"
    where = "previous_frame"
    block = "mean"
    trials = ({"share": 0.002}, {"share": 0.01})
    fitted = ("share",)
    looks_back = True
    settles = "a bright capture followed at once by dark frames"
    share: float = parameter(0.0, "1", -0.2, 0.2, source=PRIOR)
    older_share: float = parameter(0.0, "1", -0.1, 0.1, source="traps empty over several frames")
    fullness_per_e: float = parameter(0.0, "e-1", 0.0, 10.0, source="1 over the electrons that the traps hold")
    power: float = parameter(1.0, "1", 0.2, 2.0, source="traps of many depths: below 1")
    noise: float = parameter(1.0, "1", 0.0, 1.0, source="1 where each electron stays by chance, 0 for a fixed share")

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form whose traps fill up, and the one of a power."""
        return (cls(share=0.002, fullness_per_e=0.05), cls(share=0.002, power=0.6))

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return forms by another law (traps that fill up, slow ones, a power), and the one with less noise."""
        forms = [self.with_parameters(noise=0.5)] if self.noise == 1.0 else []
        if self.fullness_per_e == 0.0 and not self.older_share and self.power == 1.0:
            forms.append(self.with_parameters(fullness_per_e=0.05))
            forms.append(self.with_parameters(older_share=0.1 * self.share))
            forms.append(self.with_parameters(power=0.7))
        return tuple(forms)

    def free(self) -> tuple[str, ...]:
        """Return the share, its law's further parameters (fullness, the older frame's, the power), and a lesser
        noise."""
        further = {"power": self.power != 1.0, "older_share": bool(self.older_share)}
        law = next((name for name, used in further.items() if used), "fullness_per_e" if self.fullness_per_e else "")
        return ("share", *((law,) if law else ()), *(("noise",) if self.noise != 1.0 else ()))

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal + self._left(signal, context)).astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return one outcome: what stays behind is drawn as light is, its scatter shrunk to the share that it has."""
        left = np.broadcast_to(np.maximum(self._left(signal, context), 0.0), signal.shape)
        scatter = np.sqrt(self.noise) * (rng.poisson(left) - left)
        return cast(Signal, (self.mean(signal, context) + scatter).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Signal:
        return np.asarray(self.noise * np.maximum(self._left(signal, context), 0.0))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the first frame's difference from the others, and with what noise hands on.

        What a pixel held by chance comes back by as much in the frame after: frames of a series are alike by ρ₁ = dr/dS
        of what is released, and by m one further. The scatter about their mean falls by 2·Σ(1 − k/n)·ρ_k/(n − 1) of
        the variance, and the mean's variance, which pixels show, rises by 2·Σ(1 − k/n)·ρ_k of what it is for noise.
        """
        previous, own = self._held(context.previous_e, context), self._held(before.mean, context)
        frames: Any = getattr(context, "frames", 1.0)
        counted = np.where(frames > 2, frames - 1.0, frames)  # the first of three or more is not among them
        alike = (self._rise(before.mean, context), self.older_share)
        calmer = _alike(alike, counted) / np.maximum(counted - 1.0, 1.0)
        return after.changed(
            variance=after.variance - calmer * before.variance,
            spatial_variance=after.spatial_variance + (_alike(alike, frames) + calmer) * before.variance / frames,
            first_excess=before.first_excess
            + self._released(previous, context)
            - self._released(own, context)
            + self._slow_first(previous, own, context),
        )

    def _slow_first(self, previous: Any, own: Any, context: ExposureContext) -> Any:
        """Return what slow traps give the first of n frames beyond the mean of the others, the second having it too."""
        frames: Any = getattr(context, "frames", 1.0)
        return self.older_share * (previous - own) * np.maximum(frames - 2.0, 0.0) / np.maximum(frames - 1.0, 1.0)

    def _left(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the remainder of the frame before; n − 1 of a capture's n frames follow one of their kind."""
        frames: Any = getattr(context, "frames", None)
        if frames is None:
            previous = np.zeros(1, dtype=signal.dtype) if context.previous_e is None else context.previous_e
            return self._released(previous, context) + self.older_share * previous
        previous, signal = self._held(context.previous_e, context), self._held(signal, context)
        older = np.minimum(frames, 2.0)
        slow = self.older_share * (older * previous + (frames - older) * signal) / frames
        return (self._released(previous, context) + (frames - 1.0) * self._released(signal, context)) / frames + slow

    def _held(self, light: Any, context: ExposureContext) -> Any:
        """Return what frames of some light hold at their end: what those before them left behind, too."""
        if light is None:
            return np.zeros(1)
        return light + self._released(light, context) + self.older_share * light

    def _rise(self, held: Any, context: ExposureContext) -> Any:
        """Return d(released)/d(held)."""
        well = context.camera.full_well_e
        step = 1e-3 * np.maximum(held, _LEAST_E)
        rise = (self._released(held, context) - self._released(held - step, context)) / step
        return rise if well is None else np.where(held < well, rise, 0.0)

    def _released(self, held: Any, context: ExposureContext) -> Any:
        """Return the electrons that a frame leaves to the next; no pixel holds more than its full well."""
        well = context.camera.full_well_e
        held = held if well is None else np.minimum(held, well)
        lag = self.share * held
        if self.power != 1.0:
            return lag * (np.maximum(held, _LEAST_E) / _REFERENCE_E) ** (self.power - 1.0)
        if self.fullness_per_e <= 0:
            return lag
        filled = -np.expm1(-self.fullness_per_e * np.maximum(lag, 0.0)) / self.fullness_per_e
        return np.where(lag > 0, filled, lag)


def _alike(correlations: tuple[Any, ...], frames: Any) -> Any:
    """Return 2·Σ(1 − k/n)·ρ_k over the distances k of n frames."""
    return sum(2.0 * np.maximum(1.0 - k / frames, 0.0) * rho for k, rho in enumerate(correlations, start=1))
