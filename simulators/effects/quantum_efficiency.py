"""From photons to electrons."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import ELECTRONS, PHOTONS, Proportional, Stage, parameter
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class QuantumEfficiency(Proportional):
    """Turns photons into electrons: μ_e = η·μ_p.

    The random part is in `shot_noise`: a binomial choice among Poisson photons is again Poisson.

    Source: EMVA Standard 1288, release 4.0, equation (2).
    """

    name = "quantum_efficiency"
    stage = Stage.ELECTRONS
    unit_in = PHOTONS
    unit_out = ELECTRONS
    quantum_efficiency: float = parameter(0.6, "1", 0.001, 1.0, source="datasheet, at the effective wavelength")

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return self.quantum_efficiency
