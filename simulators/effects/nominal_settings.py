"""Rounded stops taken at their printed value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from radiometer.units import exact_exposure_s, exact_f_number
from simulators.effects.base import EXPOSURE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_NEAR: Final = 0.07  # 1/60 s is really 1/64 s: 6.7 %


def _each(exact: Callable[[float], float], printed: Any) -> Any:
    """Return exact over printed value of every entry."""
    values = np.asarray(printed, dtype=np.float64)
    return np.array([exact(float(value)) / float(value) for value in values.ravel()]).reshape(values.shape)


@dataclass(frozen=True)
class NominalSettings(Scaling):
    """Exposes for the exact stop behind a printed one: 1/60 s is 1/64 s, f/5.6 is f/5.657.

    `times` and `stops` say whether it holds for both (1 and 1), or for one of them alone.

    Source: ISO 2720 and camera practice: times and f-numbers run in thirds or halves of a stop.
    """

    name = "nominal_settings"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    is_stepwise = True
    trials = ({"times": 1.0, "stops": 1.0}, {"times": 1.0, "stops": 0.0}, {"times": 0.0, "stops": 1.0})
    fitted = ()
    settles = "nothing further: the exact stops are known"
    times: float = parameter(1.0, "1", 0.0, 1.0, source="a shutter timed by a quartz keeps exact stops")
    stops: float = parameter(1.0, "1", 0.0, 1.0, source="engraved stops of a fixed diaphragm may be true")

    def factor(self, context: ExposureContext) -> Any:
        """Return exact over printed exposure, f-number included."""
        time = _each(exact_exposure_s, context.settings.exposure_s)
        stop = np.ones(1) if context.f_number is None else _each(exact_f_number, context.f_number)
        return time**self.times / stop ** (2.0 * self.stops)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the exposures look like printed stops: all within 7 % of one, not all on it (1/60 is 1/64)."""
        ratio = np.asarray(_each(exact_exposure_s, context.settings.exposure_s))
        return bool(
            np.all(np.abs(ratio - 1.0) < _NEAR) and np.any(np.abs(ratio - 1.0) > 1e-3) and np.unique(ratio).size > 2
        )
