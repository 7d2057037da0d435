"""From electrons to digital numbers, with the analogue gain."""

from __future__ import annotations

from dataclasses import dataclass

from radiometer.units import gain_factor
from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, Proportional, Stage, parameter
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class ConversionGain(Proportional):
    """Scales electrons to DN of the camera's native bit depth: y = S·10^(g/20)/c, so K = 10^(g/20)/c in DN/e-.

    Source: EMVA Standard 1288, release 4.0, equation (5).
    """

    name = "conversion_gain"
    stage = Stage.READOUT
    unit_in = ELECTRONS
    unit_out = DIGITAL_NUMBER
    conversion_gain_e_per_dn: float = parameter(2.6, "e- DN-1", 1e-4, 1e4, source="datasheet, at 0 dB")

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return gain_factor(context.settings.gain_db) / self.conversion_gain_e_per_dn
