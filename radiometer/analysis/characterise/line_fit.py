"""Weighted straight lines with the uncertainty of what they give."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_SEEN_SIGMAS = 3.0  # a bend below is chance


@dataclass(frozen=True, slots=True)
class Line:
    """y = slope·x + intercept with standard uncertainties.

    Attributes:
        slope: Slope.
        intercept: Value at x = 0 (0 where the line was tied to the origin).
        u_slope: Standard uncertainty of the slope.
        u_intercept: Standard uncertainty of the intercept.
        birge_ratio: Root of the reduced chi-square; where it is above 1 the uncertainties hold that factor.
        degrees_of_freedom: Points less parameters.
    """

    slope: float
    intercept: float
    u_slope: float
    u_intercept: float
    birge_ratio: float
    degrees_of_freedom: int


def fit_line(x: ArrayLike, y: ArrayLike, u_y: ArrayLike, *, through_origin: bool = False) -> Line:
    """Return the weighted least-squares line; scatter beyond `u_y` widens the uncertainties (Birge ratio).

    Args:
        x: Abscissae, shape (n,), taken as exact.
        y: Ordinates, shape (n,).
        u_y: Standard uncertainties of y, above 0.
        through_origin: Tie the line to the origin.

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


def curve_u(x: ArrayLike, y: ArrayLike, u_y: ArrayLike, *, through_origin: bool = False) -> float:
    """Return the standard uncertainty that a bend leaves in the slope of a straight line; 0 where none is seen.

    A term in x² is fitted beside the line. Where it stands above three of its standard uncertainties, the local slope
    (or ratio y/x, where the line is tied to the origin) is known to lie within a range only: a rectangular
    distribution over that range.

    Args:
        x: Abscissae, shape (n,).
        y: Ordinates, shape (n,).
        u_y: Standard uncertainties of y, above 0.
        through_origin: The line is tied to the origin.

    Source: JCGM 100:2008, 4.3.7, for the rectangular distribution.
    """
    xs, ys, u = (np.asarray(v, dtype=np.float64) for v in (x, y, u_y))
    columns = [xs, xs**2] if through_origin else [np.ones_like(xs), xs, xs**2]
    if xs.size <= len(columns):
        return 0.0
    scales = np.array([np.abs(column).max() or 1.0 for column in columns])
    design = np.column_stack(columns) / scales / u[:, np.newaxis]
    if np.linalg.matrix_rank(design) < len(columns):
        return 0.0
    normal = np.linalg.inv(design.T @ design)
    solution = normal @ design.T @ (ys / u)
    birge = max(1.0, _birge(design @ solution - ys / u, xs.size - len(columns)))
    bend, u_bend = float(solution[-1]), float(np.sqrt(normal[-1, -1])) * birge
    if abs(bend) <= _SEEN_SIGMAS * u_bend:
        return 0.0
    reach = float(np.ptp(xs)) * (1.0 if through_origin else 2.0)
    return abs(bend) / float(scales[-1]) * reach / math.sqrt(12.0)
