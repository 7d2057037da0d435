"""A black level that follows the temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import DIGITAL_NUMBER, PRIOR, Stage, parameter
from simulators.effects.catalogue import Offset, warmer_k
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class BlackLevelDrift(Offset):
    """Adds an offset that depends on the temperature: y' = y + c·(T − T₀) + q·(T − T₀)²; q is 0 for a plain drift.

    Source: typical 0.01 to 0.3 DN/K where no optical black is subtracted.
    """

    name = "black_level_drift"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "temperature_C"
    block = "mean"
    trials = tuple({"drift_dn_per_K": rate, "reference_C": at} for at in (25.0, 35.0) for rate in (0.1, -0.1))
    fitted = ("drift_dn_per_K", "reference_C")
    varies = "temperature_C"
    further = ({"bend_dn_per_K2": 0.001},)
    settles = "dark frames at the shortest exposure at three temperatures"
    drift_dn_per_K: float = parameter(  # noqa: N815
        0.0, "DN/K", -0.0125, 0.0125, source=PRIOR, of_full_scale=True
    )
    reference_C: float = parameter(25.0, "°C", -60.0, 120.0, source="temperature at which the stated black level holds")  # noqa: N815
    bend_dn_per_K2: float = parameter(  # noqa: N815
        0.0, "DN/K²", -0.00125, 0.00125, source="leakage in the black clamp grows with heat", of_full_scale=True
    )

    def offset(self, context: ExposureContext) -> Any:
        warmer = warmer_k(context, self.reference_C)
        return self.drift_dn_per_K * warmer + self.bend_dn_per_K2 * warmer**2
