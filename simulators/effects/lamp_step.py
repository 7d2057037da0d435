"""A source that jumps between two times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling, elapsed_s
from simulators.effects.context import ExposureContext

_TRIED_REL = 0.01  # a fit is linear in it: any size begins
_FEWEST = 4  # captures on either side of a jump: fewer may be single frames that went wrong


@dataclass(frozen=True)
class LampStep(Scaling):
    """Scales light from one moment on: L' = L·(1 + A·[t > t_0]).

    The moment is known to be between two captures, not better; it is not fitted.

    Source: arcs that move on their electrodes, supplies that switch range, flats of one evening that differ by 0.4 %.
    """

    name = "lamp_step"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "timestamp_s"
    block = "mean"
    log_prior_odds = -2.0
    prior_reason = "a drift is likelier than a jump, and a jump may be anywhere in a session"
    trials = ({"step_rel": _TRIED_REL, "time_s": 0.0},)
    fitted = ("step_rel",)
    settles = "one setting repeated through the session, in between the others"
    step_rel: float = parameter(0.0, "1", -0.9, 9.0, source="0.1 to 2 % of arcs and supplies; a lamp changed: any")
    time_s: float = parameter(0.0, "s", -1e9, 1e9, source="from the first capture on")

    def factor(self, context: ExposureContext) -> Any:
        return 1.0 + self.step_rel * (np.asarray(elapsed_s(context)) > self.time_s)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return np.unique(elapsed_s(context)).size >= 2 * _FEWEST

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return a jump in front of every capture that has several before and after it: in front of its first frame."""
        times = np.ravel(elapsed_s(context))
        begun = times if context.first_frame is None else np.ravel(elapsed_s(context.first_frame))
        times, first = np.unique(times, return_index=True)
        between = 0.5 * (times[:-1] + begun[first[1:]])[_FEWEST - 1 : times.size - _FEWEST]
        return tuple(cls(_TRIED_REL, float(time)) for time in between)
