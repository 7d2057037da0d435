"""Charge that stays one row behind while it is moved to the read-out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, KeepsMean, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ChargeTransferInefficiency(KeepsMean, CatalogueEffect):
    """Leaves a share of each packet to the next: S'_i = S_i − x_i·(S_i − S_{i−1}), x_i = x·(rows passed).

    In an even field the variance becomes (1 − x_i)² + x_i² of what it was. Vertical neighbours covary by
    x_i·(1 − x_i) of it, the more the farther they are from the read-out. What stays is a fixed share, as at a barrier.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 5; trails of a radiation-damaged CCD: Massey et al.
    (2010), MNRAS 401, 371. 1e-6 per transfer in new devices to 1e-4 in damaged ones, over 1,000 to 4,000 rows.
    """

    name = "charge_transfer_inefficiency"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    before = "read_noise"
    where = "image_y"
    block = "neighbour"
    also = ("variance",)
    log_prior_odds = -1.0
    prior_reason = "only sensors that move charge from row to row have it"
    trials = tuple({"share": share, "from_below": below} for below in (0.0, 1.0) for share in (0.02, 0.1))
    fitted = ("share",)
    settles = "even light of several levels in many frames: vertical neighbours near the read-out and far from it"
    share: float = parameter(0.0, "1", 0.0, 0.5, source="of the row read last: inefficiency times rows, 0.1 to 20 %")
    from_below: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the last row is read first")

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the packets as they arrive; the row read first follows none."""
        ahead = np.array(signal)
        if self.from_below:
            ahead[:-1] = signal[1:]
        else:
            ahead[1:] = signal[:-1]
        return cast(Signal, (signal + self._left(context) * (ahead - signal)).astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments of an even field whose white noise trails."""
        left = self._left(context)
        kept = np.square(1.0 - left) + np.square(left)
        return after.changed(
            variance=after.variance * kept,
            spatial_variance=after.spatial_variance * kept,
            neighbour_y=after.neighbour_y + left * (1.0 - left) * before.variance,
        )

    def _left(self, context: ExposureContext) -> Any:
        """Return the share of each row's charge that arrives with the next one."""
        down = context.geometry.row_fraction()
        return self.share * (1.0 - down if self.from_below else down)
