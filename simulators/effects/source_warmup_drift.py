"""A source that settles after it was switched on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import PRIOR, RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling, elapsed_s
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class SourceWarmupDrift(Scaling):
    """Scales light in time: L' = L·(1 + A·e^(−t/τ) + B·e^(−t/τ_B)).

    Source: LED and LCD backlights; typical 0.5 to 3 % over 2 to 20 min.
    """

    name = "source_warmup_drift"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "timestamp_s"
    block = "mean"
    trials = tuple({"amplitude_rel": a, "tau_s": tau} for a in (0.01, -0.01) for tau in (100.0, 300.0, 900.0))
    fitted = ("amplitude_rel", "tau_s")
    settles = "one setting repeated over an hour in between the others"
    amplitude_rel: float = parameter(0.0, "1", -0.9, 5.0, source=PRIOR)
    tau_s: float = parameter(300.0, "s", 1.0, 100000.0, source="2 to 20 min")
    second_rel: float = parameter(0.0, "1", -0.9, 5.0, source="amplitude of a second, slower term")
    second_tau_s: float = parameter(1500.0, "s", 1.0, 1000000.0, source="its time constant")

    def factor(self, context: ExposureContext) -> Any:
        time = elapsed_s(context)
        slow = self.second_rel * np.exp(-time / self.second_tau_s) if self.second_rel else 0.0
        return 1.0 + self.amplitude_rel * np.exp(-time / self.tau_s) + slow

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.ptp(elapsed_s(context)) > 0)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return two terms, a fast and a slow one."""
        span = float(np.ptp(elapsed_s(context)))
        return (cls(0.005, max(span / 20.0, 2.0), 0.005, max(span / 3.0, 5.0)),)

    def free(self) -> tuple[str, ...]:
        first = ("amplitude_rel", "tau_s")
        return (*first, "second_rel", "second_tau_s") if self.second_rel else first
