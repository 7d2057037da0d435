"""Spatial variance split into rows, columns and pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.statistics.scale import robust_sigma

_REACH_SIGMAS: Final = 4.0  # pixels whose mean lies farther from the median are hot, cold or hit
_LEAST_SIGMA_DN: Final = 0.5  # most means may show one code, and their median deviation is then 0


@dataclass(frozen=True, slots=True)
class SpatialSplit:
    """Variances of what rows, columns and single pixels add to a mean picture, in DN², with standard uncertainties.

    A variance that chance makes negative stays so: it is an estimate without bias.
    """

    row_dn2: float
    column_dn2: float
    pixel_dn2: float
    u_row_dn2: float
    u_column_dn2: float
    u_pixel_dn2: float


@dataclass(frozen=True, slots=True)
class NoiseLeft:
    """Temporal variances that are left in a frame average, in DN²: of row means, of column means, of the residual.

    A converter whose rows share noise leaves more in row means than its pixels' noise alone would.
    """

    row_means_dn2: float
    column_means_dn2: float
    rest_dn2: float

    @classmethod
    def of(
        cls, pixel_dn2: float, row_means_dn2: float, column_means_dn2: float, frames: int, shape: tuple[int, ...]
    ) -> NoiseLeft:
        """Return it for L frames, from the temporal variances of a pixel, a row's mean and a column's mean."""
        rows, columns = shape[0], shape[1]
        rest = (pixel_dn2 - row_means_dn2 - column_means_dn2) / (1 - 1 / rows - 1 / columns + 1 / (rows * columns))
        return cls(row_means_dn2 / frames, column_means_dn2 / frames, max(rest, 0.0) / frames)


def split_spatial_variance(average: NDArray[np.float64], noise: NoiseLeft) -> SpatialSplit:
    """Return the variances of rows, columns and pixels of a frame average of shape (M, N), in DN².

    With y = μ + row_m + column_n + pixel_mn the variance of the column averages is s_col² + s_pix²/M, that of the row
    averages s_row² + s_pix²/N. The residual after both are subtracted has (M − 1)(N − 1) degrees of freedom. From
    each the temporal noise of the same kind is subtracted.

    Args:
        average: Mean picture of at least 2 × 2 pixels.
        noise: Temporal variance that is left in it.

    Source: EMVA Standard 1288, release 4.0, section 8.2, solved with the degrees of freedom of an analysis of variance
    (the standard's factors differ from it by 1/(MN)).
    """
    rows, columns = average.shape
    centred = average - average.mean()
    row_means, column_means = centred.mean(axis=1), centred.mean(axis=0)
    rest = centred - row_means[:, None] - column_means[None, :]
    freedom = (rows - 1) * (columns - 1)
    measured = float(np.sum(rest * rest)) / freedom
    pixel = measured - noise.rest_dn2
    of_rows, of_columns = float(np.var(row_means, ddof=1)), float(np.var(column_means, ddof=1))
    return SpatialSplit(
        row_dn2=of_rows - pixel / columns - noise.row_means_dn2,
        column_dn2=of_columns - pixel / rows - noise.column_means_dn2,
        pixel_dn2=pixel,
        u_row_dn2=of_rows * math.sqrt(2.0 / (rows - 1)),
        u_column_dn2=of_columns * math.sqrt(2.0 / (columns - 1)),
        u_pixel_dn2=measured * math.sqrt(2.0 / freedom),
    )


def typical_mean(average: NDArray[np.float64]) -> float:
    """Return the mean of the pixels within four robust standard deviations of the median: hot ones do not count."""
    return float(np.mean(average[typical_pixels(average)]))


def typical_pixels(average: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which pixels' means are within four robust standard deviations (at least 0.5 DN) of their median."""
    reach = _REACH_SIGMAS * max(robust_sigma(average), _LEAST_SIGMA_DN)
    return np.asarray(np.abs(average - np.median(average)) <= reach)
