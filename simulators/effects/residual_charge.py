"""Charge that traps let go long after the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal

_RESTS: Final = (2.0, 15.0, 100.0)  # intervals between frames within which traps let go, to start from


@dataclass(frozen=True)
class ResidualCharge(UnitSlope, CatalogueEffect):
    """Adds what is let go in an exposure t: S' = S + (1 − exp(−t/τ))·q·Σ S_j·exp(−Δt_j/τ) over all frames before.

    Each frame leaves a share q of its charge in traps, which empty within τ whatever the camera does; what comes free
    between two exposures is swept away. Dark frames behind a bright one have a rate that falls with the time.

    Source: residual bulk image of CCDs and persistence of infrared arrays; some 0.1 to 5 % of the charge, seconds to
    hours (Rest et al. 2002, Rev. Sci. Instrum. 73, 2028; Smith et al. 2008, Proc. SPIE 7021). First-order release.
    """

    name = "residual_charge"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "full_well_saturation"
    where = "previous_frame"
    block = "mean"
    trials = ({"share": 0.01, "tau_s": 30.0},)
    fitted = ("share", "tau_s")
    looks_back = True
    log_prior_odds = -3.0
    prior_reason = "cooled CCDs and infrared arrays have such traps, other sensors hardly"
    settles = "a bright capture followed by a row of long dark frames"
    share: float = parameter(0.0, "1", 0.0, 0.5, source="residual images of cooled CCDs: 0.1 to 5 %")
    tau_s: float = parameter(30.0, "s", 1e-3, 1e6, source="seconds to hours, by the sensor's temperature")

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return traps that let go within some of the intervals between frames, and within many."""
        since: Any = np.asarray(np.nan if context.since_frame_s is None else context.since_frame_s, dtype=np.float64)
        known = since[np.isfinite(since) & (since > 0)]
        usual_s = float(np.median(known)) if known.size else cls.tau_s / _RESTS[0]
        return tuple(cls(0.01, float(np.clip(rests * usual_s, 1e-2, 1e5))) for rests in _RESTS)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return context.past is not None

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal + self._let_go(context)).astype(signal.dtype))

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        let_go = np.broadcast_to(self._let_go(context), signal.shape)
        return cast(Signal, (signal + rng.poisson(let_go)).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        return cast(Signal | float, self._let_go(context))

    @property
    def drifts(self) -> bool:
        return True

    def _let_go(self, context: ExposureContext) -> Any:
        if context.past is None:
            return 0.0
        exposure_s: Any = context.settings.exposure_s
        return self.share * -np.expm1(-exposure_s / self.tau_s) * context.past.faded(self.tau_s)
