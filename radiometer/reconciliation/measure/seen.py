"""Holds the measured statistics of a capture set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from radiometer.typing import Array

COMB_PERIODS: Final = (2, 3, 4, 5)  # a coarser step shows at one of its divisors


@dataclass(frozen=True, slots=True, eq=False)
class CaptureStatistics:
    """Measured statistics, per capture and tile: arrays (captures, tiles) in DN, or (captures,) where noted.

    Attributes:
        mean: Mean of all frames.
        variance: Temporal variance of a pixel, each frame's tile mean removed.
        variance_dof: Degrees of freedom of `variance`.
        spatial: Variance of the time mean from pixel to pixel about a quadratic surface.
        spatial_dof: Degrees of freedom of `spatial`.
        slope_x: Rise of the time mean from the tile's centre to its right edge.
        slope_y: Rise from the centre to the bottom edge.
        neighbour_x: Correlation of the temporal fluctuation of horizontal neighbours.
        neighbour_y: The same of vertical neighbours.
        first: First frame minus the mean of the others.
        pixels: Pixels of the tile that count (defects taken out).
        peak: Time mean of the brightest of them.
        low: Share of samples at 0 DN.
        high: Share of samples at full scale.
        common: (captures,) variance of the frame-common relative fluctuation over what pixel noise alone gives.
        common_unit: (captures,) relative variance that pixel noise alone gives it.
        black: (captures,) variance in DN² of an offset that all tiles of a frame share, steady change taken out.
        black_unit: (captures,) what pixel noise alone gives it.
        black_dof: (captures,) its degrees of freedom; 0 where the frames are too few.
        drift: (captures,) the same of half a wave down the frame, as a random walk of the black level has it.
        drift_unit: (captures,) what pixel noise alone gives it.
        drift_dof: (captures,) its degrees of freedom.
        row_temporal: (captures,) variance of row means from frame to frame over what pixel noise alone gives.
        row_temporal_weight: (captures,) its sensitivity: mean over rows of Σ 1/variance, in DN⁻².
        row_temporal_dof: (captures,) its degrees of freedom.
        row_temporal_light: (captures,) what rows whose light differs by 100 % would add to it.
        bands: (captures, orders) variance of a spatial frequency of the rows' light over what pixel noise alone gives.
        bands_basis: (captures, 1 + orders, bins) functions of the rows, see `row_bands`.
        bands_of_rows: (captures, orders) what 1 DN² of row noise adds.
        columns: (captures,) variance of fixed column means over what the fixed pixel pattern alone gives.
        columns_weight: (captures,) its sensitivity in DN⁻².
        columns_dof: (captures,) its degrees of freedom.
        rows: (captures,) the same of rows.
        rows_weight: (captures,) in DN⁻².
        rows_dof: (captures,) degrees of freedom.
        edge: (captures,) share of a step at a patch's edge that is in the last line inside it.
        edge_u: (captures,) its standard uncertainty; infinite where no edge is seen.
        outliers: (captures,) pixels that stand out of their tile by more than 6 robust sigmas.
        comb: (captures, periods) amplitude of a regular comb in the histogram, real part of its Fourier term.
        comb_count: (captures,) samples in that histogram.
    """

    mean: Array
    variance: Array
    variance_dof: Array
    spatial: Array
    spatial_dof: Array
    slope_x: Array
    slope_y: Array
    neighbour_x: Array
    neighbour_y: Array
    first: Array
    pixels: Array
    peak: Array
    low: Array
    high: Array
    common: Array
    common_unit: Array
    black: Array
    black_unit: Array
    black_dof: Array
    drift: Array
    drift_unit: Array
    drift_dof: Array
    row_temporal: Array
    row_temporal_weight: Array
    row_temporal_dof: Array
    row_temporal_light: Array
    bands: Array
    bands_basis: Array
    bands_of_rows: Array
    columns: Array
    columns_weight: Array
    columns_dof: Array
    rows: Array
    rows_weight: Array
    rows_dof: Array
    edge: Array
    edge_u: Array
    outliers: Array
    comb: Array
    comb_count: Array
