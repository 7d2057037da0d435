"""A black level that jumps at an event and relaxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import Offset, elapsed_s
from simulators.effects.context import ExposureContext

_TRIED_DN = 1.0  # a fit is linear in it: any size begins
_FEWEST = 3  # captures on either side of an event: fewer may be single frames that went wrong
_RESTS = (3.0, 20.0)  # mean intervals between captures within which it relaxes
_SLOWEST_S = 600.0  # what takes longer is warmth: another temperature of the camera, not a zeroing


@dataclass(frozen=True)
class EventOffset(Offset):
    """Adds an offset that dies away after an event: y' = y + b·exp(−(t − t₀)/τ) from t₀ on, y' = y before.

    The event is known to be before the first frame that shows it, not better: t₀ is that frame's time, and is not
    fitted. What has not come back by the last capture is a step, which whatever changes once (a setting, a temperature)
    gives as well.

    Source: cameras that calibrate themselves behind a shutter, or zero themselves: tens of DN, relaxing within seconds
    to minutes (thermal cameras at each flat-field correction).
    """

    name = "event_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "timestamp_s"
    block = "mean"
    also = ("first",)
    log_prior_odds = -3.0
    prior_reason = "few cameras interrupt a session, and an event may be anywhere in it"
    trials = ({"offset_dn": _TRIED_DN, "tau_s": 30.0}, {"offset_dn": -_TRIED_DN, "tau_s": 30.0})
    fitted = ("offset_dn", "tau_s")
    essential = ("offset_dn",)  # where times follow the exposures, anything that bends along them is some event
    settles = "dark frames of the shortest exposure, one after the other through the event"
    offset_dn: float = parameter(0.0, "DN", -0.25, 0.25, source="tenths of a DN to tens of DN", of_full_scale=True)
    tau_s: float = parameter(30.0, "s", 0.01, _SLOWEST_S, source="seconds to minutes")
    event_s: float = parameter(0.0, "s", -1e9, 1e9, source="from the first capture on")

    def offset(self, context: ExposureContext) -> Any:
        since = _times_of_frames(context) - self.event_s
        lifted = np.where(since < 0, 0.0, self.offset_dn * np.exp(-np.maximum(since, 0.0) / self.tau_s))
        return np.nanmean(lifted, axis=-1)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return np.unique(elapsed_s(context)).size >= 2 * _FEWEST

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return events in front of every frame with captures before and after it, short and long, up and down."""
        begun = np.unique(elapsed_s(context if context.first_frame is None else context.first_frame))
        usual_s = float(np.ptp(begun)) / max(begun.size - 1, 1)
        between = begun[_FEWEST : begun.size - _FEWEST]
        times = np.unique(_times_of_frames(context)) if between.size else between
        return tuple(
            cls(size, float(np.clip(rests * usual_s, 0.1, _SLOWEST_S)), float(time))
            for time in times[(times >= between[:1]) & (times <= between[-1:])]
            for rests in _RESTS
            for size in (_TRIED_DN, -_TRIED_DN)
        )


def _times_of_frames(context: ExposureContext) -> Any:
    """Return the time in s of each frame along a last axis, NaN where a series has fewer than others."""
    return np.asarray(elapsed_s(context))[..., None] if context.frame_times_s is None else context.frame_times_s
