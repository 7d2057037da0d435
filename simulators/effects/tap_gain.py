"""Quarters of the sensor whose amplifiers have different gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext
from simulators.effects.quarters import OfTaps, trials


@dataclass(frozen=True)
class TapGain(OfTaps, Scaling):
    """Scales electrons behind the noise by a factor that is even within each quarter: 1 + a·s_x + b·s_y + c·s_x·s_y.

    Noise is scaled as well, by which it differs from light that is uneven.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2; typical 1 to 10 % between amplifiers.
    """

    name = "tap_gain"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "image_x"
    block = "slope"
    also = ("mean", "variance")
    is_steep = True
    signal_power = 1
    trials = trials((0.02, -0.02), ("across_rel", "along_rel", "corner_rel"))
    fitted = ("across_rel", "along_rel", "corner_rel")
    table = "taps_rel"
    settles = "an even field, once as it is and once with the camera turned"
    across_rel: float = parameter(0.0, "1", -0.4, 0.4, source="1 to 10 % between amplifiers")
    along_rel: float = parameter(0.0, "1", -0.4, 0.4, source="1 to 10 % between amplifiers")
    corner_rel: float = parameter(0.0, "1", -0.1, 0.1, source="1 to 10 % between amplifiers")
    taps_rel: tuple[float, ...] = parameter((), "1", -0.4, 0.4, source="of every tap")

    def factor(self, context: ExposureContext) -> Any:
        return 1.0 + self.sizes(context)
