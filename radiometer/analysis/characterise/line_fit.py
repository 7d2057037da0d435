"""Weighted straight lines with the uncertainty of what they give."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.statistics.chances import chi2_beyond
from radiometer.statistics.least_squares import chi_square
from radiometer.statistics.model_choice import THREE_SIGMA, is_supported

_BY_CHANCE: Final = chi2_beyond(THREE_SIGMA.gain, 1)


@dataclass(frozen=True, slots=True)
class Line:
    """y = slope·x + intercept with standard uncertainties."""

    slope: float  # slope
    intercept: float  # value at x = 0 (0 where the line was tied to the origin)
    u_slope: float  # standard uncertainty of the slope
    u_intercept: float  # standard uncertainty of the intercept
    birge_ratio: float  # root of the reduced chi-square; where it is above 1 the uncertainties hold that factor
    degrees_of_freedom: int  # points less parameters

    @property
    def scatters(self) -> bool:
        """Return whether the points scatter more than noise makes them by chance in 0.3 % of such lines."""
        chi2 = self.birge_ratio**2 * self.degrees_of_freedom
        return self.degrees_of_freedom > 0 and chi2_beyond(chi2, self.degrees_of_freedom) < _BY_CHANCE


def fit_line(x: ArrayLike, y: ArrayLike, u_y: ArrayLike, *, through_origin: bool = False) -> Line:
    """Return the weighted least-squares line; scatter beyond `u_y` widens the uncertainties (Birge ratio).

    Args:
        x: Abscissae, shape (n,), taken as exact.
        u_y: Standard uncertainties of y, above 0.

    Raises:
        ValueError: If there are fewer points than parameters or they share one x.

    Source: JCGM 100:2008, annex H.3; Birge (1932) for the inflation.
    """
    xs, ys, u = (np.asarray(v, dtype=np.float64) for v in (x, y, u_y))
    columns = [xs] if through_origin else [xs, np.ones_like(xs)]
    design = np.column_stack(columns) / u[:, np.newaxis]
    scale = np.linalg.norm(design, axis=0)
    if xs.size < len(columns) or np.any(scale == 0) or np.linalg.matrix_rank(design / scale) < len(columns):
        raise ValueError(f"{xs.size} points do not determine a line")
    normal = np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
    solution = normal @ design.T @ (ys / u)
    dof = xs.size - len(columns)
    birge = _birge(design @ solution - ys / u, dof)
    u_solution = np.sqrt(np.diag(normal)) * max(1.0, birge)
    return Line(
        float(solution[0]),
        0.0 if through_origin else float(solution[1]),
        float(u_solution[0]),
        0.0 if through_origin else float(u_solution[1]),
        birge,
        dof,
    )


def _birge(residuals: NDArray[np.float64], dof: int) -> float:
    return math.sqrt(float(residuals @ residuals) / dof) if dof > 0 else 1.0


def is_bent(x: ArrayLike, y: ArrayLike, u_y: ArrayLike, *, through_origin: bool = False) -> bool:
    """Return whether points bend away from a straight line by more than their noise.

    A term in x² is fitted as well. The points bend where it lowers χ² by more than 9 and explains more than half of
    what the straight line leaves above its degrees of freedom. The uncertainties are used as given: scatter of few
    points about the wrong curve would otherwise hide the bend.
    """
    xs, ys, u = (np.asarray(v, dtype=np.float64) for v in (x, y, u_y))
    columns = [xs, xs**2] if through_origin else [np.ones_like(xs), xs, xs**2]
    if xs.size <= len(columns):
        return False
    design = np.column_stack(columns) / [np.abs(column).max() or 1.0 for column in columns] / u[:, np.newaxis]
    if np.linalg.matrix_rank(design) < len(columns):
        return False
    straight, curved = (chi_square(design[:, :count], ys / u) for count in (len(columns) - 1, len(columns)))
    freedom = xs.size - len(columns) + 1
    gain = straight - curved
    return is_supported(gain, THREE_SIGMA) and gain > (straight - freedom) / 2.0
