"""A source that turns on or droops within the exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_SETTLED: Final = 0.5  # of the shortest exposure: the exponential part is 13 % then, the rest a constant and a time


@dataclass(frozen=True)
class SourceNotProportionalToExposure(Scaling):
    """Weakens light that lasts longer: H' = H·(1 − a·(1 − (τ/t)·(1 − e^(−t/τ)))); a below 0 is a slow turn-on.

    Source: a LED flashed for the exposure; Printalyzer issue 14 saw a log-like decay.
    """

    name = "source_not_proportional_to_exposure"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -3.0
    prior_reason = "only sources that are lit for the exposure do this"
    trials = (
        {"droop_rel": 0.02, "tau_s": 0.0003},
        {"droop_rel": -0.02, "tau_s": 0.0003},
        {"droop_rel": 0.02, "tau_s": 0.001},
        {"droop_rel": 0.02, "tau_s": 0.01},
        {"droop_rel": 0.02, "tau_s": 0.1},
        {"droop_rel": -0.02, "tau_s": 0.001},
        {"droop_rel": -0.02, "tau_s": 0.01},
        {"droop_rel": -0.02, "tau_s": 0.1},
    )
    fitted = (
        "droop_rel",
        "tau_s",
    )
    settles = "one exposure at several source levels, or a photodiode on the source"
    droop_rel: float = parameter(0.0, "1", -5.0, 0.95, source="engineering prior; refined on a real rig")
    tau_s: float = parameter(0.01, "s", 1e-06, 100.0, source="time constant of the droop")

    def factor(self, context: ExposureContext) -> Any:
        """Return mean light over the exposure against light at its start."""
        x = np.asarray(context.settings.exposure_s) / self.tau_s
        return 1.0 - self.droop_rel * (1.0 + np.expm1(-x) / x)

    def unlike_itself(self, context: ExposureContext) -> bool:
        """Tell whether the source settles within the shortest exposure: a wrong exposure time looks the same."""
        return self.tau_s < _SETTLED * float(np.min(np.asarray(context.settings.exposure_s)))
