"""A camera whose gamma was left on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class GammaEnabled(CatalogueEffect):
    """Bends digital numbers: y' = D·(y/D)^(1/γ), D full scale; black level included.

    With a toe c a straight line leads from there to zero, as in Rec. 709: y' = y·c^(1/γ − 1) for y/D below c.

    Source: GenICam SFNC, Gamma; must be 1 for radiometry.
    """

    name = "gamma_enabled"
    stage = Stage.DIGITAL
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    before = "quantisation"
    where = "signal"
    block = "mean"
    neutral_at_one = ("gamma",)
    trials = (
        {"gamma": 1.02},
        {"gamma": 0.98},
        {"gamma": 1.1},
        {"gamma": 0.9},
        {"gamma": 1.5},
        {"gamma": 2.2},
        {"gamma": 0.45},
    )
    fitted = ("gamma",)
    settles = "the same digital number reached at two gains"
    gamma: float = parameter(1.0, "1", 0.2, 5.0, source="engineering prior; refined on a real rig")

    toe: float = parameter(0.0, "1", 0.0, 0.9, source="Rec. 709: 0.018, sRGB: 0.0031; 0 for none")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the bent value."""
        full = self._full_scale(context)
        share = np.maximum(signal / full, 0.0)
        bent = np.where(share > self.toe, share ** (1.0 / self.gamma), share * self._lift())
        return cast(Signal, (full * bent).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        """Return d(mean)/d(signal)."""
        share = np.maximum(signal / self._full_scale(context), 1e-6)
        return np.where(share > self.toe, share ** (1.0 / self.gamma - 1.0) / self.gamma, self._lift())

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return curves with a toe at a few levels."""
        return () if self.toe else tuple(self.with_parameters(toe=toe) for toe in (0.03, 0.08, 0.2))

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the toe only where there is one."""
        return ("gamma", "toe") if self.toe else ("gamma",)

    def _lift(self) -> float:
        """Return the steepness of the toe."""
        return float(self.toe ** (1.0 / self.gamma - 1.0)) if self.toe else 1.0

    def _full_scale(self, context: ExposureContext) -> float:
        return float((1 << context.camera.bit_depth) - 1)
