"""Gain steps that are not what the settings say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class GainStepError(Scaling):
    """Scales by the error of the gain: y' = y·10^(g·e/20)·(1 + table(g)).

    The law serves a constant error per dB; the table (linear between its gains) any other.

    Source: datasheets state 0.2 to 2 % per step.
    """

    name = "gain_step_error"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    before = "black_level"
    where = "gain_db"
    block = "mean"
    trials = ({"error_rel": 0.01}, {"error_rel": -0.01})
    fitted = ("error_rel",)
    varies = "gain_db"
    settles = "every gain step at two light levels, twice each"
    error_rel: float = parameter(0.0, "1", -0.5, 0.5, source=PRIOR)
    gains_db: tuple[float, ...] = parameter((), "dB", -20.0, 100.0, source="gains at which the table holds an error")
    errors_rel: tuple[float, ...] = parameter((), "1", -0.5, 0.5, source="relative error at these gains")

    def factor(self, context: ExposureContext) -> Any:
        gain_db = np.asarray(context.settings.gain_db)
        law = 10.0 ** (gain_db * self.error_rel / 20.0)
        return law * (1.0 + np.interp(gain_db, self.gains_db, self.errors_rel)) if self.gains_db else law

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the table over the gains in use, which covers every law; 0 dB is exact by definition."""
        steps = np.unique(np.asarray(context.settings.gain_db))
        if not 3 <= steps.size <= 16:
            return ()
        return (cls(gains_db=tuple(steps.tolist()), errors_rel=(0.0,) * steps.size),)

    def free(self) -> tuple[str, ...]:
        if not self.gains_db:
            return ("error_rel",)
        return tuple(f"errors_rel[{index}]" for index in range(1, len(self.gains_db)))
