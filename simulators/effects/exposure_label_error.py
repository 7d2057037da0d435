"""An exposure whose label is not the real one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ExposureLabelError(Scaling):
    """Takes another exposure time for frames that bear one label: H' = H·t_real/t_label.

    Source: stacks of photographs whose printed times disagree with their neighbours.
    """

    name = "exposure_label_error"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = ({"label_s": 1.0, "ratio": 1.1},)
    fitted = ("ratio",)
    settles = "neighbouring exposures, or the EXIF record"
    label_s: float = parameter(1.0, "s", 1e-09, 100000.0, source="the printed exposure time")
    ratio: float = parameter(1.0, "1", 0.001, 1000.0, source="real over printed")

    def factor(self, context: ExposureContext) -> Any:
        """Return real over stated exposure time."""
        same = np.abs(np.log(np.asarray(context.settings.exposure_s) / self.label_s)) < 1e-6
        return np.where(same, self.ratio, 1.0)

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return one start per exposure in use, a little long and a little short."""
        times = np.unique(np.asarray(context.settings.exposure_s))
        return tuple(cls(float(t), ratio) for t in times for ratio in (1.02, 0.98)) if times.size > 3 else ()
