"""A response that bends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.context import ExposureContext, Signal

_BENT_TO: Final = 4.0  # declared full wells; a well that is declared at less than a quarter is no figure of the sensor


@dataclass(frozen=True)
class ResponseNonlinearity(CatalogueEffect):
    """Bends the response: S' = S·(1 − a₂·z − a₃·z²), z = S/S_FW.

    S_FW is the full well that is declared, which pixels may pass: the curve goes on up to where it rises no more, and
    straight on from there or from four full wells.

    Source: EMVA Standard 1288, release 4.0, linearity error; typical 0.1 to 3 %.
    """

    name = "response_nonlinearity"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    trials = ({"a2": 0.01, "a3": 0.0}, {"a2": -0.01, "a3": 0.0}, {"a2": 0.0, "a3": 0.01}, {"a2": 0.0, "a3": -0.01})
    fitted = ("a2", "a3")
    settles = "one signal reached by different pairs of exposure and source level"
    a2: float = parameter(0.0, "1", -0.5, 0.5, source=PRIOR)
    a3: float = parameter(0.0, "1", -0.5, 0.5, source=PRIOR)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        well = well_e(context)
        z = np.asarray(signal / well)
        bent = np.clip(z, 0.0, self._end())
        curve = bent * (1.0 - self.a2 * bent - self.a3 * bent**2)
        return cast(Signal, (well * (curve + self._rise(bent) * (z - bent))).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        return self._rise(np.clip(signal / well_e(context), 0.0, self._end()))

    def _rise(self, z: Any) -> Any:
        return 1.0 - 2.0 * self.a2 * z - 3.0 * self.a3 * z**2

    def _end(self) -> float:
        """Return the fill z from which the response goes straight on: where it rises no more, or `_BENT_TO`."""
        roots = np.roots([-3.0 * self.a3, -2.0 * self.a2, 1.0])
        ends = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
        return float(min(ends.min(initial=_BENT_TO), _BENT_TO))
