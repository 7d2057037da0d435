"""The ends of the converter's range."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.clipping import censored_above, censored_below, limited, unevenly_limited
from simulators.effects.context import ExposureContext, Signal

_SPREAD: Final = 0.005  # of the highest code, from which a fit of the scatter begins


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
    bends = ("spread_dn",)
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
        return tuple(replace(start, spread_dn=_SPREAD * start.clip_dn) for start in cls.starts(context))

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return () if self.spread_dn or not self.clip_dn else (replace(self, spread_dn=_SPREAD * self.clip_dn),)

    def _highest(self, context: ExposureContext) -> float:
        full_scale = float(context.full_scale_dn)
        return min(self.clip_dn * context.output_scale, full_scale) if self.clip_dn else full_scale
