"""An offset in front of the gain amplifier."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import Offset, gain_of
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class BlackLevelGainSlope(Offset):
    """Adds an offset that the gain amplifies: y' = y + b·(10^(g/20) − 1).

    Source: an amplifier offset referred to its input; at 0 dB it is part of the black level.
    """

    name = "black_level_gain_slope"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = "gain_db"
    block = "mean"
    trials = (
        {"slope_dn": 0.5},
        {"slope_dn": -0.5},
        {"slope_dn": 5.0},
    )
    fitted = ("slope_dn",)
    settles = "dark frames at the shortest exposure over all gains"
    slope_dn: float = parameter(0.0, "DN", -1000.0, 1000.0, source="engineering prior; refined on a real rig")

    def offset(self, context: ExposureContext) -> Any:
        """Return the offset in DN."""
        return self.slope_dn * (gain_of(context) - 1.0)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the gain varies."""
        return bool(np.ptp(np.asarray(context.settings.gain_db)) > 0)
