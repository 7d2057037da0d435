"""Quarters of the sensor whose amplifiers bend the signal differently."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.quarters import OfTaps, trials


@dataclass(frozen=True)
class TapNonlinearity(OfTaps):
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
    log_prior_odds = -1.0
    prior_reason = "amplifiers of one sensor mostly bend alike"
    trials = trials((0.01, -0.01), ("across_rel", "along_rel", "corner_rel"))
    fitted = ("across_rel", "along_rel", "corner_rel")
    table = "taps_rel"
    settles = "even fields of many levels up to full well"
    across_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    along_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    corner_rel: float = parameter(0.0, "1", -0.3, 0.3, source="0.1 to 3 % at full well")
    taps_rel: tuple[float, ...] = parameter((), "1", -0.3, 0.3, source="of every tap")

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether there are several amplifiers, and the full well is known, in shares of which the bend is."""
        return super().usable(context) and context.camera.full_well_e is not None

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal * (1.0 + self._bend(context) * signal)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        return 1.0 + 2.0 * self._bend(context) * signal

    def _bend(self, context: ExposureContext) -> Any:
        return self.sizes(context) / (context.camera.full_well_e or 1.0)
