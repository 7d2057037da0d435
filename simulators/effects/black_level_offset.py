"""A black level that is not what the settings say."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class BlackLevelOffset(Offset):
    """Adds a constant to every value: y' = y + b.

    Source: EMVA Standard 1288, release 4.0, mu_y.dark; typical 0.5 to 20 DN.
    """

    name = "black_level_offset"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = "signal"
    block = "mean"
    trials = (
        {"offset_dn": 1.0},
        {"offset_dn": -1.0},
        {"offset_dn": 10.0},
    )
    fitted = ("offset_dn",)
    settles = "dark frames at the shortest exposure at three gains"
    offset_dn: float = parameter(0.0, "DN", -4000.0, 4000.0, source="engineering prior; refined on a real rig")

    def offset(self, context: ExposureContext) -> float:
        """Return the offset in DN."""
        return self.offset_dn
