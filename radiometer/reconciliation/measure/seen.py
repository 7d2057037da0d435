"""Holds the measured statistics of a capture set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from radiometer.typing import Array

COMB_PERIODS: Final = (2, 3, 4, 5)  # a coarser step shows at one of its divisors


@dataclass(frozen=True, slots=True, eq=False)
class CaptureStatistics:
    """Measured statistics, per capture and tile: arrays (captures, tiles) in DN, or (captures,) where noted."""

    mean: Array  # mean of all frames
    variance: Array  # temporal variance of a pixel, each frame's tile mean removed
    variance_dof: Array  # degrees of freedom of `variance`
    spatial: Array  # variance of the time mean from pixel to pixel about a quadratic surface
    spatial_dof: Array  # degrees of freedom of `spatial`
    slope_x: Array  # rise of the time mean from the tile's centre to its right edge
    slope_y: Array  # rise from the centre to the bottom edge
    neighbour_x: Array  # correlation of the temporal fluctuation of horizontal neighbours
    neighbour_y: Array  # the same of vertical neighbours
    first: Array  # first frame minus the mean of the others
    pixels: Array  # pixels of the tile that count (defects taken out)
    peak: Array  # time mean of the brightest of them
    low: Array  # share of samples at 0 DN
    high: Array  # share of samples at full scale
    common: Array  # (captures,) variance of the frame-common relative fluctuation over what pixel noise alone gives
    common_unit: Array  # (captures,) relative variance that pixel noise alone gives it
    black: Array  # (captures,) variance in DN² of an offset that all tiles of a frame share, steady change taken out
    black_unit: Array  # (captures,) what pixel noise alone gives it
    black_dof: Array  # (captures,) its degrees of freedom; 0 where the frames are too few
    drift: Array  # (captures,) the same of half a wave down the frame, as a random walk of the black level has it
    drift_unit: Array  # (captures,) what pixel noise alone gives it
    drift_dof: Array  # (captures,) its degrees of freedom
    row_temporal: Array  # (captures,) variance of row means from frame to frame over what pixel noise alone gives
    row_temporal_weight: Array  # (captures,) its sensitivity: mean over rows of Σ 1/variance, in DN⁻²
    row_temporal_dof: Array  # (captures,) its degrees of freedom
    row_temporal_light: Array  # (captures,) what rows whose light differs by 100 % would add to it
    # (captures, orders) variance of a spatial frequency of the rows' light over what pixel noise alone gives
    bands: Array
    bands_basis: Array  # (captures, 1 + orders, bins) functions of the rows, see `row_bands`
    bands_of_rows: Array  # (captures, orders) what 1 DN² of row noise adds
    columns: Array  # (captures,) variance of fixed column means over what the fixed pixel pattern alone gives
    columns_weight: Array  # (captures,) its sensitivity in DN⁻²
    columns_dof: Array  # (captures,) its degrees of freedom
    rows: Array  # (captures,) the same of rows
    rows_weight: Array  # (captures,) in DN⁻²
    rows_dof: Array  # (captures,) degrees of freedom
    edge: Array  # (captures,) share of a step at a patch's edge that is in the last line inside it
    edge_u: Array  # (captures,) its standard uncertainty; infinite where no edge is seen
    outliers: Array  # (captures,) pixels that stand out of their tile by more than 6 robust sigmas
    comb: Array  # (captures, periods) amplitude of a regular comb in the histogram, real part of its Fourier term
    comb_count: Array  # (captures,) samples in that histogram
