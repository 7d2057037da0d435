"""Light that counts more or less in a long exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import EXPOSURE, PRIOR, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_NO_THRESHOLD_S: Final = 1e5  # above any exposure
_FEWEST_EXPOSURES: Final = 6  # a power with a threshold bends through fewer by chance


@dataclass(frozen=True)
class ReciprocityFailure(Scaling):
    """Follows a power of the exposure time up to a threshold, from where on it is constant: H' = H·(min(t, t₀)/1 ms)^p.

    Source: Schwarzschild (1900), of photographic emulsions; not expected in silicon.
    """

    name = "reciprocity_failure"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -5.0
    prior_reason = "silicon counts photons: nothing of the kind is expected of it"
    trials = ({"exponent": 0.005}, {"exponent": -0.005})
    fitted = ("exponent",)
    bends = ("threshold_s",)
    settles = "one signal reached by exposure and by source level"
    exponent: float = parameter(0.0, "1", -0.5, 0.5, source=PRIOR)
    threshold_s: float = parameter(_NO_THRESHOLD_S, "s", 1e-6, _NO_THRESHOLD_S, source="none by default")

    def factor(self, context: ExposureContext) -> Any:
        return (np.minimum(np.asarray(context.settings.exposure_s), self.threshold_s) / 1e-3) ** self.exponent

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return powers of either sign up to thresholds among the exposures in use: at 0 a threshold does nothing."""
        times = np.unique(np.asarray(context.settings.exposure_s))
        if times.size < _FEWEST_EXPOSURES:
            return ()
        return tuple(cls(p, float(np.quantile(times, q))) for q in (0.3, 0.5, 0.7) for p in (0.005, -0.005))
