"""The overall system gain K from dark frames alone: the shot noise of the dark current over exposures."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.characterise.line_fit import Line, fit_line
from radiometer.analysis.characterise.spatial_split import typical_pixels
from radiometer.data import Quantity
from radiometer.statistics.scale import robust_sigma

_FEWEST_FRAMES: Final = 5
_HIGHEST_LEVERAGE: Final = 0.9
_CLIP_SIGMAS: Final = 6.0
_LARGEST_U_REL: Final = 0.2  # above it the dark current is too weak to tell the gain


@dataclass(frozen=True, slots=True)
class DarkTransfer:
    """K from dark frames, with the line and its points (mean and variance of each frame in DN and DN²)."""

    K: Quantity
    line: Line
    mean_dn: tuple[float, ...]
    variance_dn2: tuple[float, ...]


def dark_transfer(frames: Iterable[NDArray[np.float64]]) -> DarkTransfer | None:
    """Return K in DN/e- from dark frames of one temperature and several exposures, one frame at each being enough.

    Every pixel's signal is linear in the mean of all of them, d_ip = a_p + b_p·x_i, so that its fixed pattern falls out
    with a straight line per pixel. The squared residuals, averaged over pixels, are the frames' noise variances
    mixed by the line: E[r_i²] = Σ_j (I − H)_ij²·σ_j², which is solved for σ_j². Their slope over x is K, whatever the
    read noise is.

    Args:
        frames: Digital numbers of at least five frames of one region, each of the same shape.

    Returns:
        None where there are too few frames or the dark current is too weak (u of K above 20 %).

    Source: EMVA Standard 1288, release 4.0, section 7 (K from σ_y² = σ_0² + K·μ_d); the fixed pattern is removed by
    lines instead of by pairs.
    """
    flat = [np.ravel(frame) for frame in frames]
    if len(flat) < _FEWEST_FRAMES:
        return None
    values = np.stack(flat)
    values = values[:, typical_pixels(values.mean(axis=0))]
    x = values.mean(axis=1)
    design = np.column_stack([np.ones_like(x), x - x.mean()])
    if np.ptp(x) <= 0:
        return None
    hat = design @ np.linalg.inv(design.T @ design) @ design.T
    told = np.diag(hat) < _HIGHEST_LEVERAGE
    mixing = (np.eye(len(x)) - hat) ** 2
    residual = (np.eye(len(x)) - hat) @ values
    squares = np.array([_clipped_variance(row) for row in residual])
    variances, u = _unmixed(mixing, squares, values.shape[1])
    if told.sum() < _FEWEST_FRAMES or np.unique(x[told]).size < 3 or np.any(u[told] <= 0):
        return None
    line = fit_line(x[told], variances[told], u[told])
    # Scatter beyond chance widens the line's u; a bend is a misfit along the signal that repetition does not average.
    u_slope = math.hypot(line.u_slope, _halves_u(x[told], variances[told], u[told]))
    if line.slope <= 0 or u_slope > _LARGEST_U_REL * line.slope:
        return None
    return DarkTransfer(Quantity(line.slope, u_slope, "DN/e-"), line, tuple(x[told]), tuple(variances[told]))


def _halves_u(x: NDArray[np.float64], variance: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Return what the difference of the slopes below and above the middle leaves uncertain; 0 where one has no slope.

    Source: JCGM 100:2008, 4.3.7: a gain between the two, a rectangular distribution.
    """
    middle = (float(x.min()) + float(x.max())) / 2
    slopes = []
    for part in (x <= middle, x > middle):
        if np.unique(x[part]).size < 3:
            return 0.0
        slopes.append(fit_line(x[part], variance[part], u[part]).slope)
    return abs(slopes[1] - slopes[0]) / math.sqrt(12.0)


def _clipped_variance(residual: NDArray[np.float64]) -> float:
    """Return the variance without what particles and telegraph noise throw beyond six standard deviations."""
    distance = np.abs(residual - np.median(residual))
    sigma = max(robust_sigma(residual), 1e-9)
    return float(np.var(residual[distance <= _CLIP_SIGMAS * sigma]))


def _unmixed(
    mixing: NDArray[np.float64], squares: NDArray[np.float64], pixels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the frames' variances and their standard uncertainties."""
    inverse = np.linalg.pinv(mixing)
    variances = inverse @ squares
    u_squares = squares * math.sqrt(2.0 / max(pixels - 1, 1))
    return variances, np.sqrt((inverse**2) @ u_squares**2)
