"""A quantum efficiency that follows the temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import PHOTONS, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling, warmer_k
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class QuantumEfficiencyTemperature(Scaling):
    """Scales the response to light: S' = S·(1 + c·(T − 25 °C) + q·(T − 25 °C)²); q is 0 for a straight line.

    Source: silicon photodiodes; 0.05 to 0.2 %/K, more in the near infrared.
    """

    name = "quantum_efficiency_temperature"
    stage = Stage.PHOTONS
    unit_in = unit_out = PHOTONS
    before = "quantum_efficiency"
    where = "temperature_C"
    block = "mean"
    trials = ({"coefficient_per_K": 0.001}, {"coefficient_per_K": -0.001})
    fitted = ("coefficient_per_K",)
    varies = "temperature_C"
    further = ({"bend_per_K2": 1e-5},)
    settles = "lit captures at three temperatures in random order"
    coefficient_per_K: float = parameter(0.0, "1/K", -0.02, 0.02, source=PRIOR)  # noqa: N815
    bend_per_K2: float = parameter(0.0, "1/K²", -1e-3, 1e-3, source="the band edge moves with temperature")  # noqa: N815

    def factor(self, context: ExposureContext) -> Any:
        warmer = warmer_k(context, 25.0)
        return 1.0 + self.coefficient_per_K * warmer + self.bend_per_K2 * warmer**2
