"""Full pixels that push charge to their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, well_e
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.pixel_mixing import exchange_between_neighbours, exchange_moments
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class BrighterFatter(CatalogueEffect):
    """Moves charge between neighbours in proportion to their fill: S' = S − b·z·Σ(S − S_j), z = S/S_FW.

    In an even field the variance falls by 8·b·z and neighbours correlate by 2·b·z.

    Source: Antilogus et al. (2014), simplified to the four nearest neighbours.
    """

    name = "brighter_fatter"
    stage = Stage.WELL
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    where = "signal"
    block = "neighbour"
    also = ("variance",)
    trials = (
        {"share": 0.005},
        {"share": 0.02},
    )
    fitted = ("share", "edge_fill")
    settles = "neighbour correlation over a photon-transfer series"
    share: float = parameter(0.0, "1", 0.0, 0.1, source="at full well; below 1 % for small CMOS pixels")
    edge_fill: float = parameter(0.2, "1", 0.0, 1.0, source="fill on both sides of an edge over the brightest patch's")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the signal of an even field: what leaves a pixel comes back."""
        return signal

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the electrons after the exchange."""
        return exchange_between_neighbours(signal, self.share * np.clip(signal / well_e(context), 0.0, 1.2))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments of a tile whose pixels exchange charge."""
        share = self.share * np.clip(before.mean / well_e(context), 0.0, 1.2)
        mixed = exchange_moments(after, share, light=1.0)
        edge = self.edge_fill * np.max(share, axis=(-2, -1), keepdims=True)
        return mixed.changed(edge_share=before.edge_share + edge)
