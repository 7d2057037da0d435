"""Quarters of the sensor whose amplifiers have different black levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext
from simulators.effects.quarters import OfTaps, trials


@dataclass(frozen=True)
class TapOffset(OfTaps, Offset):
    """Adds an offset that is even within each quarter: y' = y + a·s_x + b·s_y + c·s_x·s_y.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2: each output amplifier has its own video chain.
    """

    name = "tap_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "image_x"
    block = "mean"
    also = ("slope",)
    is_steep = True
    signal_power = 0
    trials = trials((2.0, -2.0), ("across_dn", "along_dn", "corner_dn"))
    fitted = ("across_dn", "along_dn", "corner_dn")
    table = "taps_dn"
    settles = "an average of many frames of no exposure"
    across_dn: float = parameter(0.0, "DN", -0.1, 0.1, source="some DN to hundreds", of_full_scale=True)
    along_dn: float = parameter(0.0, "DN", -0.1, 0.1, source="some DN to hundreds", of_full_scale=True)
    corner_dn: float = parameter(0.0, "DN", -0.1, 0.1, source="some DN to hundreds", of_full_scale=True)
    taps_dn: tuple[float, ...] = parameter((), "DN", -0.1, 0.1, source="of every tap", of_full_scale=True)

    def offset(self, context: ExposureContext) -> Any:
        return self.sizes(context)
