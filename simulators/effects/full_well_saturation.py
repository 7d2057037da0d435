"""What a pixel can hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulators.effects.base import ELECTRONS, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.clipping import censored_above, limited
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class FullWellSaturation(CatalogueEffect):
    """Limits the electrons that a pixel holds: S' = min(S, S_FW), times the number of binned pixels."""

    name = "full_well_saturation"
    stage = Stage.WELL
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    trials = ()
    fitted = ("full_well_e",)
    settles = "a ladder of exposures to 120 % of the full well at 0 dB"
    full_well_e: float = parameter(10_000.0, "e-", 10.0, 1e7, source="datasheet")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the electrons that stay in the pixel."""
        return np.minimum(signal, self._capacity_e(context))

    def slope(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return 1 below the full well and 0 on it."""
        return (signal < self._capacity_e(context)).astype(signal.dtype)

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments of the limited, nearly normal count."""
        return limited(before, lambda tail: censored_above(tail, self._capacity_e(context)))

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return full wells from a little below the declared one to a third of it."""
        return tuple(cls(well_e(context) * share) for share in (0.97, 0.93, 0.88, 0.8, 0.7, 0.6, 0.45, 0.33))

    def _capacity_e(self, context: ExposureContext) -> float:
        return self.full_well_e * context.geometry.binning**2
