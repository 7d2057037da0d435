"""Dark current whose mean the sensor subtracts by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class DarkCurrentClamped(UnitSlope, CatalogueEffect):
    """Adds the noise of thermal electrons but not their mean: optical-black rows take it away.

    A share f of the mean stays (below 0 where the masked rows are warmer than the others); 0 for a perfect clamp.

    Source: AVT Alvium user guide, dark current compensation; EMVA Standard 1288, release 4.0, section 7.2.
    """

    name = "dark_current_clamped"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    where = "exposure_s"
    block = "variance"
    log_prior_odds = -1.0
    prior_reason = "rarer than a plain dark current, most of which it can imitate"
    trials = ({"rate_e_per_s": 3.0}, {"rate_e_per_s": 30.0})
    fitted = ("rate_e_per_s", "doubling_K")
    further = ({"left_share": 0.01},)
    heated = "rate_e_per_s"
    settles = "dark frames from the shortest to the longest exposure"
    rate_e_per_s: float = parameter(0.0, "e- s-1", 0.0, 1000000.0, source=PRIOR)
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the rate holds at")  # noqa: N815
    doubling_K: float = parameter(7.0, "K", 2.0, 30.0, source="silicon: 6 to 8 K")  # noqa: N815
    left_share: float = parameter(0.0, "1", -0.5, 0.9, source="masked rows are not quite as warm as the others")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        if not self.left_share:
            return signal
        return cast(Signal, (signal + self.left_share * self.electrons(context)).astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        expected = float(self.electrons(context))
        clamped = (1.0 - self.left_share) * expected
        return cast(Signal, (signal + rng.poisson(expected, signal.shape) - clamped).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Any:
        return self.electrons(context)

    def electrons(self, context: ExposureContext) -> Any:
        """Return the thermal electrons that the sensor subtracts again."""
        return self.rate_e_per_s * self.warmed(context) * context.settings.exposure_s
