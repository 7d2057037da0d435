"""Light that counts more or less in a long exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ReciprocityFailure(Scaling):
    """Follows a power of the exposure time: H' = H·(t/1 ms)^p.

    Source: Schwarzschild (1900), of photographic emulsions; not expected in silicon.
    """

    name = "reciprocity_failure"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = (
        {"exponent": 0.005},
        {"exponent": -0.005},
    )
    fitted = ("exponent",)
    settles = "one signal reached by exposure and by source level"
    exponent: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor of exposure."""
        return (np.asarray(context.settings.exposure_s) / 1e-3) ** self.exponent
