"""An exposure that grows or falls from row to row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class RowDependentExposure(Scaling):
    """Exposes each row for a separate time: H' = H·(t + τ·r − a·t·r)/t, r the share of rows read before.

    Rows are cleared and read one after the other: unequal paces add the same time at every exposure, τ at the last row,
    of either sign; the part that scales with the exposure is a. A time added alone is what light does that leaks into
    rows which wait (`parasitic_light_sensitivity`), and a share lost alone what any shading of the sensor does:
    neither identifies this effect.

    Source: radiometric model of MicaSense RedEdge and Parrot Sequoia, L ∝ 1/(t + a₂·y − a₃·t·y), with the maker's a₂
    and a₃ in each frame. Over 960 rows 60 to 110 µs, and −1 to 6 %.
    """

    name = "row_dependent_exposure"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "image_y"
    block = "mean"
    also = ("slope",)
    trials = ({"added_s": -1e-05}, {"added_s": 1e-05}, {"added_s": -1e-04}, {"added_s": 1e-04})
    fitted = ("added_s", "lost_share")
    settles = "the gradient along image_y of an even field at several exposures, with the camera turned once"
    added_s: float = parameter(0.0, "s", -0.1, 0.1, source="at the last row: 60 to 110 µs in RedEdge's sensors")
    lost_share: float = parameter(0.0, "1", -0.5, 0.5, source="at the last row: −0.01 to 0.06 in the same")

    def factor(self, context: ExposureContext) -> Any:
        down = context.geometry.row_fraction()
        return np.maximum(1.0 + (self.added_s / context.settings.exposure_s - self.lost_share) * down, 0.0)
