"""Charge that diffuses to the neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.pixel_mixing import exchange_between_neighbours, exchange_moments
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class Crosstalk(KeepsMean, CatalogueEffect):
    """Moves a share of the charge to each of the four neighbours: S' = S − x·Σ(S − S_j).

    In an even field the variance falls by 8·x and neighbours correlate by 2·x at every signal. Neighbours in the column
    get d more than those in the row; d is 0 where both are alike.

    Source: charge diffusion in silicon; typical 0.2 to 2 %.
    """

    name = "crosstalk"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    where = "image_x"
    block = "neighbour"
    trials = ({"share": 0.005}, {"share": 0.02})
    fitted = ("share",)
    bends = ("further_down",)
    settles = "neighbour correlation at low and at high signal"
    share: float = parameter(0.0, "1", 0.0, 0.2, source=PRIOR)
    further_down: float = parameter(0.0, "1", -0.1, 0.1, source="pixels and their wiring are not square")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        return exchange_between_neighbours(signal, self.share, self.further_down)

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        mixed = exchange_moments(after, np.full((1, 1, 1), self.share), 1.0, self.further_down)
        return mixed.changed(edge_share=before.edge_share + self.share + 0.5 * self.further_down)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the exchange that differs between rows and columns."""
        return () if self.further_down else (self.with_parameters(further_down=self.share / 10.0),)
