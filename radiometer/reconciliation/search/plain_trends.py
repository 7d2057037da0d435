"""Plain trends that hold a name to account: what no more freedom than an entry's explains better is not that entry.

They are fitted like effects, in all statistics at once, but belong to no catalogue: where one of them wins, the
disagreement stays unnamed. A trend whose `where` is empty answers for every covariate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, EXPOSURE, IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Offset, Scaling
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ConstantTrend(Offset):
    """Adds the same to every digital number: y' = y + b.

    Source: the constant term of any trend.
    """

    name = "constant_trend"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = ""
    block = "mean"
    trials = ({"offset_dn": 1.0}, {"offset_dn": -1.0})
    fitted = ("offset_dn",)
    offset_dn: float = parameter(0.0, "DN", -1.0, 1.0, source="free", of_full_scale=True)

    def offset(self, context: ExposureContext) -> float:
        """Return b in DN."""
        return self.offset_dn


@dataclass(frozen=True)
class RadialTrend(Scaling):
    """Scales light by a polynomial of the field radius: E' = E·(1 + a₂·ρ² + a₄·ρ⁴).

    Source: the first even terms of any curve about the lens's axis.
    """

    name = "radial_trend"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = ""
    block = "slope"
    trials = ({"a2": -0.03}, {"a2": 0.03})
    fitted = ("a2", "a4")
    a2: float = parameter(0.0, "1", -1.0, 1.0, source="free")
    a4: float = parameter(0.0, "1", -1.0, 1.0, source="free")

    def factor(self, context: ExposureContext) -> Any:
        """Return the polynomial."""
        rho2 = np.square(context.geometry.field_radius())
        return np.maximum(1.0 + self.a2 * rho2 + self.a4 * rho2**2, 0.01)


@dataclass(frozen=True)
class ExposureTrend(Scaling):
    """Scales light by a straight line along the logarithm of the exposure time: H' = H·(1 + b·ln(t/1 ms)).

    Source: the first term of any slow curve along the exposures.
    """

    name = "exposure_trend"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = ({"b": 0.005}, {"b": -0.005})
    fitted = ("b",)
    b: float = parameter(0.0, "1", -0.05, 0.05, source="free")

    def factor(self, context: ExposureContext) -> Any:
        """Return the line."""
        return np.maximum(1.0 + self.b * np.log(np.asarray(context.settings.exposure_s) / 1e-3), 0.01)


TRENDS: Final[tuple[type[CatalogueEffect], ...]] = (ConstantTrend, RadialTrend, ExposureTrend)
