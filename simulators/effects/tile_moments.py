"""Moments of a signal, and of a tile of pixels: what a capture's statistics are expected to be."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from simulators.effects.context import Signal


@dataclass(frozen=True)
class Moments:
    """Expected value and variances of a signal, all of one shape."""

    squared: ClassVar[tuple[str, ...]] = ("variance", "spatial_variance", "common_variance", "ordered_variance")
    linear: ClassVar[tuple[str, ...]] = ()
    figures: ClassVar[tuple[str, ...]] = ()  # numbers of the whole frame, which no array holds

    mean: Signal  # expected value
    variance: Signal  # temporal variance of one pixel about it
    spatial_variance: Signal  # variance from pixel to pixel that stays from frame to frame (fixed pattern)
    common_variance: Signal  # temporal variance that all pixels of one frame share (flicker)
    # Variance of the frames of a capture by their order, no chance; the first of them has `first_excess`
    ordered_variance: Signal | float = field(default=0.0, kw_only=True)
    # The moments in front of the rounding to whole codes; None where nothing was rounded
    unrounded: Moments | None = field(default=None, kw_only=True)

    @property
    def variance_of_lines(self) -> tuple[Any, Any]:
        """Return what pixels of one row or column share beyond their own: fixed pattern, and noise."""
        return 0.0, 0.0

    @classmethod
    def exactly(cls, mean: Signal) -> Self:
        """Return the moments of a signal that is known exactly."""
        nothing = np.zeros_like(mean)
        return cls(mean, nothing, nothing, nothing)

    def changed(self, **fields: Any) -> Self:
        """Return the moments with other values of some fields, as `dataclasses.replace` does in a tenth of the time."""
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__, **fields)
        return found

    def passed(self, mean: Signal, slope: Signal | float) -> Self:
        """Return the moments behind a link of the chain, without what the link itself adds.

        Args:
            slope: d(mean)/d(signal).
        """
        if isinstance(slope, float) and slope == 1.0:
            return self.changed(mean=mean)
        slope2 = np.square(slope)
        changed: dict[str, Any] = {name: carried(getattr(self, name), slope2) for name in self.squared}
        changed |= {name: carried(getattr(self, name), slope) for name in self.linear}
        return self.changed(mean=mean, **changed)


def carried(values: Signal | float, factor: Signal | float) -> Signal:
    """Return values times a factor; a lone zero, which represents all, stays one."""
    nothing = not values if isinstance(values, float) else values.size == 1 and not values.item()
    return np.asarray(values if nothing else values * factor)


@dataclass(frozen=True)
class TileMoments(Moments):
    """Expected statistics of tiles; every field broadcasts against `mean`."""

    squared: ClassVar[tuple[str, ...]] = (
        *Moments.squared, "row_variance", "band_variance", "fixed_column_variance", "fixed_row_variance",
        "neighbour_x", "neighbour_y", "limit_variance", "renewed_variance", "beyond_x", "beyond_y", "beyond_rows",
        "uneven_noise",
    )  # fmt: skip
    linear: ClassVar[tuple[str, ...]] = ("first_excess",)
    figures: ClassVar[tuple[str, ...]] = ("comb_step", "comb_kept", "band_frequency")

    row_variance: Signal  # temporal variance that the pixels of one row share within a frame
    band_variance: Signal  # temporal variance of light that goes as a wave along the rows, at a new phase in each frame
    fixed_column_variance: Signal  # fixed-pattern variance that the pixels of one column share
    fixed_row_variance: Signal  # fixed-pattern variance that the pixels of one row share
    neighbour_x: Signal  # covariance of the fluctuations of horizontal neighbours
    neighbour_y: Signal  # the same of vertical neighbours
    first_excess: Signal  # mean of a capture's first frame minus that of its other frames
    edge_share: Signal  # share of a step at a patch's edge that is in the last line inside it
    outliers: Signal  # expected number of outlying pixels in the frame
    unsteady: Signal  # expected number of pixels that scatter far more than the others of their tile
    comb_step: float = 1.0  # spacing of the codes in use; 1 for all
    band_frequency: float = 0.0  # periods of that wave per row
    # Part of the fixed-pattern variance that limits which differ from pixel to pixel leave
    limit_variance: Signal | float = 0.0
    renewed_variance: Signal | float = 0.0  # part of it whose pattern differs between settings
    # Sum of the covariances with the pixels of a row from the second neighbour on, to one side
    beyond_x: Signal | float = 0.0
    beyond_y: Signal | float = 0.0  # the same of a column
    beyond_rows: Signal | float = 0.0  # the same with all pixels of the rows below, but for the vertical neighbour
    # Standard deviation from pixel to pixel of the temporal variance, which stays from frame to frame
    uneven_noise: Signal | float = 0.0
    comb_kept: float = 1.0  # how many codes of each spacing occur

    @property
    def variance_of_lines(self) -> tuple[Any, Any]:
        return self.fixed_column_variance + self.fixed_row_variance, self.row_variance

    @classmethod
    def exactly(cls, mean: Signal) -> Self:
        nothing = np.zeros((1,) * mean.ndim)
        return cls(
            mean, variance=nothing, spatial_variance=nothing, common_variance=nothing, row_variance=nothing,
            band_variance=nothing, fixed_column_variance=nothing, fixed_row_variance=nothing, neighbour_x=nothing,
            neighbour_y=nothing, first_excess=nothing, edge_share=nothing, outliers=nothing,
            unsteady=nothing,
        )  # fmt: skip
