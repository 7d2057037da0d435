"""A response that bends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class ResponseNonlinearity(CatalogueEffect):
    """Bends the response: S' = S·(1 − a₂·z − a₃·z²), z = S/S_FW.

    Source: EMVA Standard 1288, release 4.0, linearity error; typical 0.1 to 3 %.
    """

    name = "response_nonlinearity"
    stage = Stage.WELL
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    trials = (
        {"a2": 0.01, "a3": 0.0},
        {"a2": -0.01, "a3": 0.0},
        {"a2": 0.0, "a3": 0.01},
        {"a2": 0.0, "a3": -0.01},
    )
    fitted = (
        "a2",
        "a3",
    )
    settles = "one signal reached by different pairs of exposure and source level"
    a2: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")
    a3: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the electrons as the bent response gives them."""
        z = np.clip(signal / well_e(context), 0.0, 1.2)
        return cast(Signal, (signal * (1.0 - self.a2 * z - self.a3 * z**2)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        """Return 1 − 2·a₂·z − 3·a₃·z²."""
        z = np.clip(signal / well_e(context), 0.0, 1.2)
        return 1.0 - 2.0 * self.a2 * z - 3.0 * self.a3 * z**2
