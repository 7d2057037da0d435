"""Light that leaks into a global shutter while rows wait for readout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ParasiticLightSensitivity(Scaling):
    """Adds light during readout: H' = H·(1 + p·r^n/t), r the share of rows read before, p = leak × readout time.

    n is 1 where all rows leak alike. A leak takes nothing away: rows that are exposed for less time the later they are
    read are those of `row_dependent_exposure`.

    Source: Balluff note on parasitic light sensitivity: non-linear at short exposures, with a row gradient.
    """

    name = "parasitic_light_sensitivity"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "image_y"
    block = "mean"
    trials = ({"leak_s": 2e-06}, {"leak_s": 1e-05}, {"leak_s": 0.0001})
    fitted = ("leak_s",)
    further = ({"row_power": 1.05},)
    settles = "the gradient along image_y at the shortest exposure"
    leak_s: float = parameter(0.0, "s", 0.0, 0.01, source="1/PLS × readout time: 1/10000 × 10 ms = 1 µs")
    row_power: float = parameter(1.0, "1", 0.2, 5.0, source="shading of the storage nodes; 1 for none")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor of exposure, larger for rows that are read later."""
        waited = np.maximum(context.geometry.row_fraction(), 1e-6) ** self.row_power
        return 1.0 + self.leak_s * waited / context.settings.exposure_s
