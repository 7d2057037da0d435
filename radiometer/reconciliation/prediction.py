"""The expected statistics of a capture set."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from radiometer.typing import Array
from simulators.effects.context import Signal
from simulators.effects.rounding import excess_kurtosis, rounding_amplitude
from simulators.effects.tile_moments import Moments


@dataclass(frozen=True, eq=False)
class Prediction:
    """Expected statistics, named and shaped as in CaptureStatistics; those of several models along a first axis."""

    mean: Array
    slope_x: Array
    slope_y: Array
    variance: Array
    spatial: Array
    neighbour_x: Array
    neighbour_y: Array
    first: Array
    common_variance: Array
    row_variance: Array
    fixed_column_variance: Array
    fixed_row_variance: Array
    edge: Array
    outliers: Array
    comb_step: float
    comb_kept: float
    signal: Array  # (captures, tiles) light signal in electrons, for regressors
    gain: Array  # (captures,) DN per electron
    fixed: Array  # (captures, tiles) fixed-pattern part of `spatial` in DN²
    unrounded: Moments  # moments in DN before they are rounded to whole codes
    band_variance: Array  # (captures, tiles) variance of light that goes as a wave along the rows, in DN²
    band_frequency: float  # periods of that wave per row
    mixed_x: Array  # (captures, tiles) correlation of neighbours in a row that exchange charge, without what rows share
    mixed_y: Array  # the same in a column
    limit_variance: Array  # (captures, tiles) part of `fixed` in DN² that limits which differ from pixel to pixel leave
    renewed_variance: Array  # (captures, tiles) part of it for which each setting has a separate pattern
    beyond_x: Array  # (captures, tiles) sum of the correlations in a row from the second neighbour on, to one side
    beyond_y: Array  # the same in a column
    beyond_rows: Array  # the same with all pixels of the rows below, but for the vertical neighbour

    @cached_property
    def waves(self) -> bool:
        """Return whether any light goes as a wave along the rows."""
        return bool(self.band_variance.any())

    @cached_property
    def mixes(self) -> bool:
        """Return whether any neighbours in a row exchange charge."""
        return bool(self.mixed_x.any())

    @property
    def rounding(self) -> Array:
        """Return how far rounding to whole codes may move the mean, in DN, (captures, tiles)."""
        return of_tiles(rounding_amplitude(self.unrounded), self.mean.shape)

    @property
    def kurtosis(self) -> Array:
        """Return the excess kurtosis that rounding to whole codes gives a pixel's values, (captures, tiles)."""
        return of_tiles(excess_kurtosis(self.unrounded), self.mean.shape)


def of_tiles(values: Signal, shape: tuple[int, ...]) -> Array:
    """Return the mean over the points of each tile, of this shape."""
    values = np.asarray(values, dtype=np.float64)
    if values.shape[-1] == 1:
        found = np.empty(shape)
        found[...] = values[..., 0]
        return found
    return np.asarray(0.25 * (values[..., 0] + values[..., 1] + values[..., 2] + values[..., 3]))
