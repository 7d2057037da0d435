"""Read noise that two successive pixels of a line share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class CorrelatedReadNoise(KeepsMean, CatalogueEffect):
    """Adds noise of which each sample enters two successive pixels: e_k = s·(n_k ± n_{k−1})/√2, n white.

    Pixels gain the variance s², and neighbours along a line the covariance ±s²/2, at every signal alike. It is below
    zero where a sample counts as the level of one pixel and as the reset of the next, above where an amplifier is slow.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 6, correlated double sampling; neighbours in biases
    of an SBIG STL-1001E correlate by −0.06 to −0.08, those two pixels apart by less than 0.01.
    """

    name = "correlated_read_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "neighbour"
    acts_by_square = True
    log_prior_odds = -1.0
    prior_reason = "a converter for each column has no pixel before another; charge that diffuses is usual"
    trials = tuple({"sigma_e": size, "sign": sign} for sign in (-1.0, 1.0) for size in (1.0, 4.0))
    fitted = ("sigma_e",)
    settles = "many dark frames of the shortest exposure, and even light"
    sigma_e: float = parameter(0.0, "e-", 0.0, 1000.0, source="a third to a half of the read noise")
    sign: float = parameter(-1.0, "1", -1.0, 1.0, source="−1 or 1: whether successive pixels share it reversed")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with the noise on it; a line begins with an independent sample."""
        drawn = rng.standard_normal((signal.shape[0], signal.shape[1] + 1), dtype=np.float32)
        return cast(Signal, signal + self.sigma_e / math.sqrt(2.0) * (drawn[:, 1:] + self.sign * drawn[:, :-1]))

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        return 0.5 * self.sigma_e**2 * (1.0 + self.sign**2)

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the covariance of successive pixels."""
        return after.changed(neighbour_x=before.neighbour_x + 0.5 * self.sign * self.sigma_e**2)
