"""A source that turns on or droops within the exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy.special import gamma, gammainc

from simulators.effects.base import EXPOSURE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_STRAIGHT, _SLOW = 2.0, 0.6  # stretches from which a fit begins


@dataclass(frozen=True)
class SourceNotProportionalToExposure(Scaling):
    """Weakens light that lasts longer: H' = H·(1 − a·(1 − (τ/t)·(1 − e^(−t/τ)))); a below 0 is a slow turn-on.

    The light sags as a·(1 − e^(−(t/τ)^β)): at once and ever more slowly for β below 1, along a straight line that
    ends for β above it. Its mean over the exposure is then a·(1 − Γ(1 + 1/β)·P(1/β, (t/τ)^β)·τ/t), P the regularised
    incomplete gamma function; for β = 1 that is the equation above.

    Source: a LED flashed for the exposure; Printalyzer issue 14 saw a log-like decay.
    """

    name = "source_not_proportional_to_exposure"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -3.0
    prior_reason = "only sources that are lit for the exposure do this"
    trials = tuple(
        {"droop_rel": droop, "tau_s": tau}
        for taus in ((0.0003,), (0.001, 0.01, 0.1))
        for droop in (0.02, -0.02)
        for tau in taus
    )
    fitted = ("droop_rel", "tau_s")
    further = ({"stretch": _STRAIGHT}, {"stretch": _SLOW})
    settles = "one exposure at several source levels, or a photodiode on the source"
    droop_rel: float = parameter(0.0, "1", -5.0, 0.95, source=PRIOR)
    tau_s: float = parameter(0.01, "s", 1e-06, 100.0, source="time constant of the droop")
    stretch: float = parameter(1.0, "1", 0.2, 5.0, source="1 is an exponential; heat that spreads gives a half")

    def factor(self, context: ExposureContext) -> Any:
        """Return mean light over the exposure against light at its start."""
        x = np.asarray(context.settings.exposure_s) / self.tau_s
        if self.stretch == 1.0:
            return 1.0 - self.droop_rel * (1.0 + np.expm1(-x) / x)
        order = 1.0 / self.stretch
        return 1.0 - self.droop_rel * (1.0 - gamma(1.0 + order) * gammainc(order, x**self.stretch) / x)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return sags along a line that ends, of either sign, and slow ones."""
        return tuple(
            cls(droop, tau_s, stretch)
            for droop in (0.02, -0.02)
            for tau_s in (0.0003, 0.001, 0.01)
            for stretch in (_STRAIGHT, _SLOW)
        )
