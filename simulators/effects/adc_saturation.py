"""The ends of the converter's range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.clipping import censored_above, censored_below, limited
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class AdcSaturation(CatalogueEffect):
    """Clips to the codes that there are: 0 to 2^b − 1 of the output's bit depth b."""

    name = "adc_saturation"
    stage = Stage.DIGITAL
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER

    where = "signal"
    block = "mean"
    trials = ()
    fitted = ("clip_dn",)
    settles = "over-exposed captures at two gains: a converter clips at one DN, a full well at one signal"
    clip_dn: float = parameter(0.0, "DN", 0.0, 65535.0, source="highest code that occurs; 0 for full scale")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return DN within the converter's range."""
        return np.clip(signal, 0.0, self._highest(context))

    def slope(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return 1 inside the range and 0 outside."""
        return ((signal > 0) & (signal < self._highest(context))).astype(signal.dtype)

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments of the clipped, nearly normal value."""
        return limited(before, lambda tail: censored_below(censored_above(tail, self._highest(context)), 0.0))

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return highest codes from a little below full scale to half of it."""
        full_scale = float((1 << context.camera.bit_depth) - 1)
        return tuple(cls(round(full_scale * share)) for share in (0.98, 0.95, 0.9, 0.8, 0.65, 0.5))

    def _highest(self, context: ExposureContext) -> float:
        full_scale = float(context.full_scale_dn)
        return min(self.clip_dn * context.output_scale, full_scale) if self.clip_dn else full_scale
