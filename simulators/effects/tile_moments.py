"""Moments of a tile of pixels: what a capture's statistics are expected to be, beside mean and variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import Moments
from simulators.effects.context import Signal


def carried(values: Signal | float, factor: Signal | float) -> Signal:
    """Return values times a factor; a lone zero, which stands for all, stays one."""
    nothing = not values if isinstance(values, float) else values.size == 1 and not values.item()
    return np.asarray(values if nothing else values * factor)


@dataclass(frozen=True, slots=True)
class TileMoments(Moments):
    """Expected statistics of tiles; every field broadcasts against `mean`.

    Attributes:
        row_variance: Temporal variance that the pixels of one row share within a frame.
        band_variance: Temporal variance of light that goes as a wave along the rows, at a new phase in each frame.
        fixed_column_variance: Fixed-pattern variance that the pixels of one column share.
        fixed_row_variance: Fixed-pattern variance that the pixels of one row share.
        neighbour_x: Covariance of the fluctuations of horizontal neighbours.
        neighbour_y: The same of vertical neighbours.
        first_excess: Mean of a capture's first frame minus that of its other frames.
        edge_share: Share of a step at a patch's edge that lies in the last line inside it.
        outliers: Expected number of outlying pixels in the frame.
        comb_step: Spacing of the codes in use; 1 for all.
        comb_kept: How many codes of each spacing occur.
        limit_variance: Part of the fixed-pattern variance that limits which differ from pixel to pixel leave.
        band_frequency: Periods of that wave per row.
    """

    row_variance: Signal
    band_variance: Signal
    fixed_column_variance: Signal
    fixed_row_variance: Signal
    neighbour_x: Signal
    neighbour_y: Signal
    first_excess: Signal
    edge_share: Signal
    outliers: Signal
    comb_step: float = 1.0
    band_frequency: float = 0.0
    limit_variance: Signal | float = 0.0
    comb_kept: float = 1.0

    @classmethod
    def exactly(cls, mean: Signal) -> TileMoments:
        """Return the moments of a signal that is known exactly."""
        nothing = np.zeros((1,) * mean.ndim)
        return cls(
            mean,
            variance=nothing,
            spatial_variance=nothing,
            common_variance=nothing,
            row_variance=nothing,
            band_variance=nothing,
            fixed_column_variance=nothing,
            fixed_row_variance=nothing,
            neighbour_x=nothing,
            neighbour_y=nothing,
            first_excess=nothing,
            edge_share=nothing,
            outliers=nothing,
        )
