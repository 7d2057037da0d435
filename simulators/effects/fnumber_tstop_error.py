"""Stops that let through more or less light than their number says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import IRRADIANCE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class FnumberTstopError(Scaling):
    """Scales light per stop: E' = E·(1 + e)^s·(1 + c·s²)·(1 + table(N)), s = 2·log₂(N/4) stops from f/4.

    The law serves a constant error per stop; the table (linear in log N between its stops) any other.

    Source: iris scales are good to 1 to 5 % per stop.
    """

    name = "fnumber_tstop_error"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "mean"
    trials = ({"error_per_stop": 0.01}, {"error_per_stop": -0.01}, {"error_per_stop": 0.05})
    fitted = ("error_per_stop",)
    varies = "f_number"
    settles = "pairs of f-numbers at one exposure"
    error_per_stop: float = parameter(0.0, "1", -0.5, 0.5, source=PRIOR)
    curvature: float = parameter(0.0, "1", -0.2, 0.2, source="change of the error from stop to stop")
    f_numbers: tuple[float, ...] = parameter((), "1", 0.1, 1000.0, source="f-numbers at which the table holds an error")
    errors_rel: tuple[float, ...] = parameter((), "1", -0.9, 3.0, source="relative error at these f-numbers")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor of irradiance; 1 at f/4 by the law."""
        known: Any = 4.0 if context.f_number is None else context.f_number
        stops = 2.0 * np.log2(np.asarray(known) / 4.0)
        law = (1.0 + self.error_per_stop) ** stops * (1.0 + self.curvature * stops**2)
        if not self.f_numbers:
            return law
        return law * (1.0 + np.interp(np.log(known), np.log(self.f_numbers), self.errors_rel))

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law with curvature, and the table over the stops in use, which covers every law."""
        used = np.unique(np.asarray(context.f_number))
        if used.size < 3:
            return ()
        return (cls(f_numbers=tuple(used.tolist()), errors_rel=(0.0,) * used.size),)

    def free(self) -> tuple[str, ...]:
        if not self.f_numbers:
            return ("error_per_stop",)
        reference = min(range(len(self.f_numbers)), key=lambda i: abs(math.log(self.f_numbers[i] / 4.0)))
        return tuple(f"errors_rel[{i}]" for i in range(len(self.f_numbers)) if i != reference)
