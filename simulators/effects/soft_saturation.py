"""A full well that is reached softly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.context import ExposureContext, Signal

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
        *(
            {"knee": knee, "ceiling": ceiling, "hardness": hardness}
            for knee, ceiling in ((0.8, 1.0), (0.7, 1.0), (0.6, 1.0), (0.6, 0.8), (0.85, 1.05))
            for hardness in _PLAIN
        ),
        *(
            {"knee": knee, "ceiling": ceiling, "charging": 1.0}
            for knee, ceiling in ((0.8, 1.2), (0.7, 1.2), (0.6, 1.2), (0.6, 2.0))
        ),
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
