"""An offset in front of the gain amplifier."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, PRIOR, Stage, parameter
from simulators.effects.catalogue import Offset, gain_of
from simulators.effects.context import ExposureContext

_MOST_GAINS: Final = 16  # more are a sweep: a start at each would only cost time
_BEND: Final = 0.01  # from which a fit begins


@dataclass(frozen=True)
class BlackLevelGainSlope(Offset):
    """Adds an offset that the gain amplifies: y' = y + b·(G − 1 + c·(G − 1)²), G = 10^(g/20), g from where it begins.

    It begins at 0 dB where one amplifier does it all; an offset behind the first of two meets the second's gain alone.
    c is 0 where the offset is the same at every gain.

    Source: an amplifier offset referred to its input; at 0 dB it is part of the black level.
    """

    name = "black_level_gain_slope"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "gain_db"
    block = "mean"
    trials = ({"slope_dn": 0.5}, {"slope_dn": -0.5}, {"slope_dn": 5.0})
    fitted = ("slope_dn",)
    bends = ("bend",)
    varies = "gain_db"
    settles = "dark frames at the shortest exposure over all gains"
    slope_dn: float = parameter(0.0, "DN", -0.25, 0.25, source=PRIOR, of_full_scale=True)
    from_db: float = parameter(0.0, "dB", 0.0, 100.0, source="cameras mix analog and digital gain")
    bend: float = parameter(0.0, "1", -1.0, 1.0, source="an amplifier's offset moves with its feedback")

    def offset(self, context: ExposureContext) -> Any:
        more = np.maximum(gain_of(context) / 10.0 ** (self.from_db / 20.0), 1.0) - 1.0
        return self.slope_dn * (more + self.bend * np.square(more))

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return amplifiers that begin at each of the gains in use but the highest two."""
        gains = np.unique(np.asarray(context.settings.gain_db))
        return tuple(cls(0.5, g) for g in gains[1:-2].tolist() if g > 0) if gains.size <= _MOST_GAINS else ()

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the same in place of one amplifier, and one amplifier with a bend."""
        if self.from_db or self.bend:
            return ()
        later = (form.with_parameters(slope_dn=self.slope_dn) for form in self.covers(context))
        return (*later, self.with_parameters(bend=_BEND))
