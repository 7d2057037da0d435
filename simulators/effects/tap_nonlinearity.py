"""Quarters of the sensor whose amplifiers bend the signal differently."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.quarters import by_quarter


@dataclass(frozen=True)
class TapNonlinearity(CatalogueEffect):
    """Bends the signal by an amount that is even within each quarter: n' = n·(1 + q·n/n_full), q from the quarter.

    q = a·s_x + b·s_y + c·s_x·s_y, and n_full is the full well.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2; typical 0.1 to 3 % at full well.
    """

    name = "tap_nonlinearity"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    also = ("slope",)
    is_steep = True
    log_prior_odds = -2.0
    prior_reason = "most sensors have one amplifier, and those of one sensor bend alike"
    trials = (
        {"across_rel": 0.01, "along_rel": 0.01, "corner_rel": 0.01},
    )  # the law is linear in them: one start reaches all
    fitted = ("across_rel", "along_rel", "corner_rel")
    settles = "even fields of many levels up to full well"
    across_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    along_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    corner_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether the full well is known, in shares of which the bend is stated."""
        return context.camera.full_well_e is not None

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the bent signal in electrons."""
        return cast(Signal, (signal * (1.0 + self._bend(context) * signal)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        """Return 1 + 2·q·n/n_full."""
        return 1.0 + 2.0 * self._bend(context) * signal

    def _bend(self, context: ExposureContext) -> Any:
        known = by_quarter(context, self.across_rel, self.along_rel, self.corner_rel)
        return known / (context.camera.full_well_e or 1.0)
