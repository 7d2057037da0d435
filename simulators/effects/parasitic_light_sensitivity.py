"""Light that leaks into a global shutter while rows wait for readout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ParasiticLightSensitivity(Scaling):
    """Adds light during readout: H' = H·(1 + p·r/t), r the share of rows read before, p = leak × readout time.

    Source: Balluff note on parasitic light sensitivity: non-linear at short exposures, with a row gradient.
    """

    name = "parasitic_light_sensitivity"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "image_y"
    block = "mean"
    trials = (
        {"leak_s": 2e-06},
        {"leak_s": 1e-05},
        {"leak_s": 0.0001},
    )
    fitted = ("leak_s",)
    settles = "the gradient along image_y at the shortest exposure"
    leak_s: float = parameter(0.0, "s", -0.01, 0.01, source="1/PLS × readout time: 1/10000 × 10 ms = 1 µs")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor of exposure, larger for rows that are read later."""
        return 1.0 + self.leak_s * context.geometry.row_fraction() / context.settings.exposure_s
