"""The ends of the range: full wells, soft and sharp, and the converter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Self, cast

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.special import ndtr

from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_NODES, _WEIGHTS = hermegauss(5)  # of a normal distribution: exact for polynomials up to the ninth degree
_NODES_OF_NORMAL: Final = tuple(zip(_NODES.tolist(), (_WEIGHTS / _WEIGHTS.sum()).tolist(), strict=True))
_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
_FAR_SIGMAS = 9.0  # farther below the limit nothing of the distribution reaches it (1e-19)


def censored_above(before: Moments, ceiling: float | NDArray[np.floating[Any]]) -> Moments:
    """Return the moments of min(X, ceiling) for normal X with the given moments.

    With z = (c − μ)/σ, Φ and φ the normal distribution and density:
    E = μ·Φ + c·(1 − Φ) − σ·φ and Var = (μ² + σ²)·Φ − σ·(μ + c)·φ + c²·(1 − Φ) − E², written about c for precision.
    Fixed-pattern and common variances shrink by the squared chance Φ² of staying below the limit.

    Source: Tobin (1958), moments of a censored normal variable.

    Args:
        ceiling: Highest value, same unit.
    """
    sigma = np.sqrt(np.maximum(before.variance, 1e-24))
    offset, variance = np.asarray(before.mean - ceiling), np.asarray(before.variance)
    shape = np.broadcast_shapes(offset.shape, sigma.shape)
    offset, sigma = np.broadcast_to(offset, shape), np.broadcast_to(sigma, shape)
    near = offset > -_FAR_SIGMAS * sigma
    first, left, below = offset.copy(), np.broadcast_to(variance, shape).copy(), np.ones(shape)
    first[near], left[near], below[near] = _censored(offset[near], sigma[near])
    return Moments(ceiling + first, left, before.spatial_variance * below**2, before.common_variance * below**2)


def _censored(offset: Signal, sigma: Signal) -> tuple[Signal, Signal, Signal]:
    """Return mean (about the ceiling) and variance of a censored normal variable, and its chance to stay below."""
    z = -offset / sigma
    below, density = ndtr(z), np.exp(-0.5 * np.square(z)) / _SQRT_2PI
    first = offset * below - sigma * density
    second = (np.square(offset) + np.square(sigma)) * below - sigma * offset * density
    return first, np.maximum(second - np.square(first), 0.0), below


def censored_below(before: Moments, floor: float) -> Moments:
    """Return the moments of max(X, floor) for normal X: the mirror image of `censored_above`."""
    mirrored = censored_above(
        Moments(-before.mean, before.variance, before.spatial_variance, before.common_variance), -floor
    )
    return Moments(-mirrored.mean, mirrored.variance, mirrored.spatial_variance, mirrored.common_variance)


def limited(before: Moments, limit: Callable[[Moments], Moments]) -> Moments:
    """Return the moments behind a limit; what lines and neighbours of tiles share shrinks as fixed patterns do."""
    after = limit(before) if not isinstance(before, TileMoments) else _limited_tile(before, limit)
    return after if before.unrounded is None else after.changed(unrounded=limited(before.unrounded, limit))


def _limited_tile(before: TileMoments, limit: Callable[[Moments], Moments]) -> TileMoments:
    one = np.ones((1,) * before.mean.ndim)
    after = limit(Moments(before.mean, before.variance, one, before.common_variance))
    kept = before.passed(after.mean, np.sqrt(after.spatial_variance))
    return kept.changed(variance=after.variance, common_variance=after.common_variance)


def is_reached(before: Moments, limit: float) -> bool:
    """Tell whether a limit from above is felt at all."""
    return bool(np.max(before.mean + _FAR_SIGMAS * np.sqrt(np.maximum(before.variance, 0.0))) > limit)


def unevenly_limited(before: Moments, limit: Callable[[Moments, float], Moments]) -> Moments:
    """Return the moments behind limits that scatter normally from pixel to pixel, what that leaves as fixed pattern.

    Args:
        before: Moments before it.
        limit: Gives the moments behind a limit that is so many standard deviations away from the usual one.
    """
    parts = [(weight, limit(before, node)) for node, weight in _NODES_OF_NORMAL]
    mean = sum(weight * part.mean for weight, part in parts)
    left = sum(weight * np.square(part.mean - mean) for weight, part in parts)
    alike = ("comb_step", "comb_kept", "band_frequency", "unrounded")
    names = [entry.name for entry in fields(before) if entry.name not in alike]
    after = before.changed(**{name: sum(weight * getattr(part, name) for weight, part in parts) for name in names})
    after = after.changed(spatial_variance=after.spatial_variance + left)
    if before.unrounded is not None:
        after = after.changed(unrounded=unevenly_limited(before.unrounded, limit))
    return after.changed(limit_variance=after.limit_variance + left) if isinstance(after, TileMoments) else after


_SPREAD_OF_CODES: Final = 0.005  # of the highest code, from which a fit of the scatter begins


@dataclass(frozen=True)
class AdcSaturation(CatalogueEffect):
    """Clips to the codes that there are: 0 to 2^b − 1 of the output's bit depth b.

    Where there are several converters, or offsets are taken out behind them, each pixel clips at a separate code,
    normal with standard deviation s.

    Source: column-parallel and multi-tap read-out.
    """

    name = "adc_saturation"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER

    where = "signal"
    block = "mean"
    saturates = "sharply"
    trials = ()
    fitted = ("clip_dn",)
    settles = "over-exposed captures at two gains: a converter clips at one DN, a full well at one signal"
    clip_dn: float = parameter(
        0.0, "DN", 0.0, 1.0, source="highest code that occurs; 0 for full scale", of_full_scale=True
    )
    spread_dn: float = parameter(
        0.0, "DN", 0.0, 0.06, source="scatter of that code from pixel to pixel", of_full_scale=True
    )

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return np.clip(signal, 0.0, self._highest(context))

    def slope(self, signal: Signal, context: ExposureContext) -> Signal:
        return ((signal > 0) & (signal < self._highest(context))).astype(signal.dtype)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        if not self.spread_dn:
            return self.mean(signal, context)
        uneven = context.fixed_rng(self.name).standard_normal(signal.shape, dtype=np.float32)
        highest = np.rint(self._highest(context) + self.spread_dn * context.output_scale * uneven)
        return np.clip(signal, 0.0, np.clip(highest, 0.0, context.full_scale_dn)).astype(signal.dtype)

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        if not self.spread_dn:
            return self._clipped(before, self._highest(context))
        spread = self.spread_dn * context.output_scale
        highest = self._highest(context)
        return unevenly_limited(before, lambda moments, sigmas: self._clipped(moments, highest + sigmas * spread))

    @staticmethod
    def _clipped(before: Moments, highest: float) -> Moments:
        return limited(before, lambda tail: censored_below(censored_above(tail, highest), 0.0))

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return highest codes from a little below full scale to what four cut-off bits leave."""
        full_scale = float((1 << context.camera.bit_depth) - 1)
        return tuple(cls(round(full_scale * share)) for share in (0.98, 0.95, 0.9, 0.8, *np.geomspace(0.65, 1 / 16, 8)))

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return codes that scatter by half a percent."""
        return tuple(replace(start, spread_dn=_SPREAD_OF_CODES * start.clip_dn) for start in cls.starts(context))

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return () if self.spread_dn or not self.clip_dn else (replace(self, spread_dn=_SPREAD_OF_CODES * self.clip_dn),)

    def free(self) -> tuple[str, ...]:
        return ("clip_dn", "spread_dn") if self.spread_dn else ("clip_dn",)

    def _highest(self, context: ExposureContext) -> float:
        full_scale = float(context.full_scale_dn)
        return min(self.clip_dn * context.output_scale, full_scale) if self.clip_dn else full_scale


_SPREAD_OF_WELLS: Final = 0.01  # from which a fit of the scatter begins


@dataclass(frozen=True)
class FullWellSaturation(CatalogueEffect):
    """Limits the electrons that a pixel holds: S' = min(S, S_FW·(1 + s·z)), times the number of binned pixels.

    z is normal, the same in all frames; s is 0 where all pixels hold alike.

    Source: wells differ by their implants, typically by 1 %.
    """

    name = "full_well_saturation"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    saturates = "sharply"
    trials = ()
    fitted = ("full_well_e",)
    further = ({"spread_rel": _SPREAD_OF_WELLS},)
    settles = "a ladder of exposures to 120 % of the full well at 0 dB"
    full_well_e: float = parameter(10_000.0, "e-", 10.0, 1e7, source="datasheet")
    spread_rel: float = parameter(0.0, "1", 0.0, 0.2, source="scatter of the wells from pixel to pixel")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return np.minimum(signal, self._capacity_e(context))

    def slope(self, signal: Signal, context: ExposureContext) -> Signal:
        return (signal < self._capacity_e(context)).astype(signal.dtype)

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        well = self._capacity_e(context)
        if not self.spread_rel:
            return self._limited(before, well)
        spread = self.spread_rel * self.full_well_e * context.geometry.binning
        return unevenly_limited(before, lambda moments, sigmas: self._limited(moments, well + sigmas * spread))

    @staticmethod
    def _limited(before: Moments, well: float) -> Moments:
        return limited(before, lambda tail: censored_above(tail, well)) if is_reached(before, well) else before

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        if not self.spread_rel:
            return self.mean(signal, context)
        uneven = context.fixed_rng(self.name).standard_normal(signal.shape, dtype=np.float32)
        spread = self.spread_rel * self.full_well_e * context.geometry.binning
        wells = np.maximum(self._capacity_e(context) + spread * uneven, 0.0)
        return cast(Signal, np.minimum(signal, wells).astype(signal.dtype))

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return full wells from a little below the declared one to a third of it."""
        return tuple(cls(well_e(context) * share) for share in (0.97, 0.93, 0.88, 0.8, 0.7, 0.6, 0.45, 0.33))

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return wells that differ by one percent."""
        return tuple(replace(start, spread_rel=_SPREAD_OF_WELLS) for start in cls.starts(context))

    def _capacity_e(self, context: ExposureContext) -> float:
        return self.full_well_e * context.geometry.binning**2


_PLAIN: Final = (1.0, 2.0)  # hardnesses that are tried as they are; any other is fitted
_NARROWEST: Final = 0.02  # of the full well between knee and ceiling: what is narrower is a well that is simply full


@dataclass(frozen=True)
class SoftSaturation(CatalogueEffect):
    """Compresses above a knee: y = (z − z_k)/w, z' = z_k + w·y/(1 + y^p)^(1/p), w = z_c − z_k, z = S/S_FW.

    Where the rest of the well fills up like a capacitor, z' = z_k + w·(1 − e^−y).

    Source: anti-blooming drains begin to take charge before the well is full.
    """

    name = "soft_saturation"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    saturates = "softly"
    log_prior_odds = -3.0
    prior_reason = "its knees take fourteen forms"
    trials = (
        {"knee": 0.8, "ceiling": 1.0, "hardness": 1.0},
        {"knee": 0.8, "ceiling": 1.0, "hardness": 2.0},
        {"knee": 0.7, "ceiling": 1.0, "hardness": 1.0},
        {"knee": 0.7, "ceiling": 1.0, "hardness": 2.0},
        {"knee": 0.6, "ceiling": 1.0, "hardness": 1.0},
        {"knee": 0.6, "ceiling": 1.0, "hardness": 2.0},
        {"knee": 0.6, "ceiling": 0.8, "hardness": 1.0},
        {"knee": 0.6, "ceiling": 0.8, "hardness": 2.0},
        {"knee": 0.85, "ceiling": 1.05, "hardness": 1.0},
        {"knee": 0.85, "ceiling": 1.05, "hardness": 2.0},
        {"knee": 0.8, "ceiling": 1.2, "charging": 1.0},
        {"knee": 0.7, "ceiling": 1.2, "charging": 1.0},
        {"knee": 0.6, "ceiling": 1.2, "charging": 1.0},
        {"knee": 0.6, "ceiling": 2.0, "charging": 1.0},
    )
    fitted = ("knee", "ceiling")
    settles = "a ladder of exposures to 120 % of the full well"
    knee: float = parameter(0.8, "1", 0.05, 1.5, source="share of the full well at which it begins")
    ceiling: float = parameter(1.0, "1", 0.1, 20.0, source="share of the full well that is never passed")
    hardness: float = parameter(2.0, "1", 0.5, 10.0, source="1 is very soft, 10 almost a clip")
    charging: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the rest fills up like a capacitor")

    def free(self) -> tuple[str, ...]:
        return self.fitted if self.charging or self.hardness in _PLAIN else (*self.fitted, "hardness")

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the knee of any hardness and the one that charges up, where it is not that already."""
        free = self.with_parameters(charging=0.0, hardness=1.5)
        charging = self.with_parameters(charging=1.0, hardness=2.0)
        if self.charging:
            return (free,)
        return (free, charging) if self.hardness in _PLAIN else (charging,)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        z = signal / well_e(context)
        width = max(self.ceiling - self.knee, _NARROWEST)
        y = np.maximum(z - self.knee, 0.0) / width
        above = -np.expm1(-y) if self.charging else y / (1.0 + y**self.hardness) ** (1.0 / self.hardness)
        soft = self.knee + width * above
        return cast(Signal, (np.where(z > self.knee, soft, z) * well_e(context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        width = max(self.ceiling - self.knee, _NARROWEST)
        y = np.maximum(signal / well_e(context) - self.knee, 0.0) / width
        return np.exp(-y) if self.charging else (1.0 + y**self.hardness) ** (-1.0 / self.hardness - 1.0)
