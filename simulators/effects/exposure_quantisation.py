"""Exposure times that the sensor can only realise in whole lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simulators.effects.base import EXPOSURE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_LINE_TIMES_S: Final = np.geomspace(2e-6, 6e-5, 2400)  # so dense that sawteeth of a millisecond's lines are hit


@dataclass(frozen=True)
class ExposureQuantisation(Scaling):
    """Rounds the exposure time to whole lines: t' = q·⌊t/q + r⌋.

    r is 0 where the camera rounds down, 0.5 to the nearest, 1 up.

    Source: ARTCAM-264IMX manual: line time 13.28 µs; typical 5 to 30 µs.
    """

    name = "exposure_quantisation"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    is_stepwise = True
    log_prior_odds = -20.0
    prior_reason = "a grid of steps fits anything; a real one moves all short exposures and brings thousands of nats"
    trials = tuple({"quantum_s": float(q), "rounding": r} for r in (0.0, 0.5, 1.0) for q in _LINE_TIMES_S)
    fitted = ()
    settles = "four exposures within one line time of each other"
    quantum_s: float = parameter(1e-09, "s", 1e-09, 0.01, source=PRIOR)
    rounding: float = parameter(0.0, "1", 0.0, 1.0, source="0 down, 0.5 nearest, 1 up")

    profiled = "quantum_s"

    def factor(self, context: ExposureContext) -> Any:
        time = np.asarray(context.settings.exposure_s)
        lines = np.maximum(np.floor(time / self.quantum_s + self.rounding + 1e-9), 1.0)
        return self.quantum_s * lines / time
