"""Electrons that heat sets free."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class DarkCurrent(Offset):
    """Adds thermal electrons: μ_d = D₀·2^((T − T₀)/T_d)·t.

    Counted before `shot_noise`, so they carry their own shot noise. Two entries add up: a finding is added to the
    datasheet's figure. A frame without a temperature counts as being at T₀.

    Source: EMVA Standard 1288, release 4.0, equations (15) and (16).
    """

    name = "dark_current"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "shot_noise"
    where = "exposure_s"
    law_along = ("temperature_C",)  # what does not grow in proportion to the exposure is no current
    block = "mean"
    trials = tuple({"rate_e_per_s": rate, "doubling_K": 7.0} for rate in (1.0, 10.0, 100.0))
    fitted = ("rate_e_per_s", "doubling_K")
    heated = "rate_e_per_s"
    settles = "dark frames from the shortest to the longest exposure at three temperatures"
    rate_e_per_s: float = parameter(1.0, "e- s-1", 0.0, 1e6, source="datasheet; 0.5 to 20 at 35 °C is usual")
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the rate holds at")  # noqa: N815
    doubling_K: float = parameter(7.0, "K", 2.0, 30.0, source="silicon: 6 to 8 K near room temperature")  # noqa: N815

    @property
    def drifts(self) -> bool:
        return True

    def offset(self, context: ExposureContext) -> Any:
        """Return the expected thermal electrons per (binned) pixel."""
        return self.electrons(context)

    def electrons(self, context: ExposureContext) -> Any:
        """Return the expected thermal electrons per (binned) pixel."""
        return self.rate_e_per_s * self.warmed(context) * context.settings.exposure_s * context.geometry.binning**2
