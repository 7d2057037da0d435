"""Dark signals that differ from pixel to pixel."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.catalogue import FixedOffsets


@dataclass(frozen=True)
class Dsnu(FixedOffsets):
    """Adds a fixed offset to each pixel, normal with standard deviation s.

    Source: EMVA Standard 1288, release 4.0, DSNU1288; typical 0.5 to 3 e-.
    """

    name = "dsnu"
    where = "gain_db"
    block = "spatial"
    trials = ({"sigma_e": 0.5}, {"sigma_e": 2.0})
    settles = "an average of many dark frames at the shortest exposure"
