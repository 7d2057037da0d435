"""What a pixel can hold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self, cast

import numpy as np

from simulators.effects.base import ELECTRONS, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.clipping import censored_above, is_reached, limited, unevenly_limited
from simulators.effects.context import ExposureContext, Signal

_SPREAD: Final = 0.01  # from which a fit of the scatter begins


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
    further = ({"spread_rel": _SPREAD},)
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
        return tuple(replace(start, spread_rel=_SPREAD) for start in cls.starts(context))

    def _capacity_e(self, context: ExposureContext) -> float:
        return self.full_well_e * context.geometry.binning**2
