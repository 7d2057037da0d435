"""A screen whose gamma is not the stated one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class DisplayGammaError(Scaling):
    """Bends the scale of displayed levels: L' = L·c^e, c the displayed level (1 is white).

    Source: display gamma 2.2 ± 0.2; an error of e in the exponent.
    """

    name = "display_gamma_error"
    stage = Stage.SCENE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "patch_level"
    block = "mean"
    trials = (
        {"exponent": 0.01},
        {"exponent": -0.01},
        {"exponent": 0.1},
    )
    fitted = ("exponent",)
    settles = "the same patches at another exposure"
    exponent: float = parameter(0.0, "1", -3.0, 3.0, source="engineering prior; refined on a real rig")

    def factor(self, context: ExposureContext) -> Any:
        """Return shown over stated radiance."""
        return 1.0 if context.code is None else np.maximum(context.code, 1e-9) ** self.exponent
