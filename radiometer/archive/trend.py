"""Trends over months: drift of a source or of the instrument, with outliers and a control chart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.errors import InputError

MONTH_S: Final = 365.25 / 12 * 86400.0
# A drift is claimed from this many standard uncertainties on: one false claim in 370 archives without a drift.
CLAIM_SIGMAS: Final = 3.0
_OUTLIER_SIGMAS: Final = 4.0
_MINIMUM_READINGS: Final = 8

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """The history of one quantity of one patch.

    Attributes:
        patch: Name of the patch.
        quantity: Name of the quantity.
        unit: Its unit.
        time_s: Times in s since 1970, ascending, shape (n,).
        value: Values, same shape.
        u: Stated standard uncertainties, same shape.
        line: Fitted straight line at the times.
        u_line: Standard uncertainty of the line there.
        outlier: Which readings lie further than 4 of their total sigmas off the line; they take no part.
        excess_rel: Relative scatter from reading to reading beyond the stated uncertainties (k = 1).
        drift_per_month: Relative drift per month of 30.44 days.
        u_drift_per_month: Its standard uncertainty.
    """

    patch: str
    quantity: str
    unit: str
    time_s: Array
    value: Array
    u: Array
    line: Array
    u_line: Array
    outlier: NDArray[np.bool_]
    excess_rel: float
    drift_per_month: float
    u_drift_per_month: float

    @property
    def drifts(self) -> bool:
        """Tell whether the drift is claimed: beyond 3 standard uncertainties."""
        return abs(self.drift_per_month) > CLAIM_SIGMAS * self.u_drift_per_month

    def to_mapping(self) -> dict[str, Any]:
        """Return the figures as plain numbers."""
        return {
            "patch": self.patch,
            "quantity": self.quantity,
            "unit": self.unit,
            "readings": int(self.time_s.size),
            "outliers": [float(t) for t in self.time_s[self.outlier]],
            "months": float((self.time_s[-1] - self.time_s[0]) / MONTH_S),
            "drift_per_month": {"value": self.drift_per_month, "u": self.u_drift_per_month, "unit": "1"},
            "drifts": self.drifts,
            "excess_scatter_rel": self.excess_rel,
        }


def fit_trend(time_s: Array, value: Array, u: Array, *, patch: str = "", quantity: str = "", unit: str = "") -> Trend:
    """Return the straight-line history of a quantity with the drift per month and its uncertainty.

    The stated uncertainties hold what each reading shares with the others (the calibration) and what it does not;
    only the scatter that is seen tells how much is not shared. So the readings are weighed by their own noise
    u_rel² brought to the scatter about the line: smaller where the readings agree better than stated, larger by an
    excess term where they agree worse. Outliers beyond 4 sigmas leave the fit, one at a time.

    Args:
        time_s: Times in s, shape (n,), any order.
        value: Values, above 0.
        u: Stated standard uncertainties, above 0.
        patch: Name for the result.
        quantity: Name for the result.
        unit: Unit for the result.

    Raises:
        InputError: If there are fewer than 8 readings, or they are not above 0, or all at one time.
    """
    order = np.argsort(time_s, kind="stable")
    time_s, value, u = time_s[order], value[order], u[order]
    _refuse_unfit(time_s, value, u, patch)
    months = (time_s - time_s.mean()) / MONTH_S
    level = float(np.median(value))
    relative, sigma = value / level, u / level
    outlier = np.zeros(value.size, bool)
    while True:
        line, covariance, scatter = _straight_line(months[~outlier], relative[~outlier], sigma[~outlier])
        residual = np.abs(relative - line[0] - line[1] * months) / (scatter * sigma)
        residual[outlier] = 0.0
        worst = int(residual.argmax())
        if residual[worst] <= _OUTLIER_SIGMAS or outlier.sum() > value.size // 4:
            break
        outlier[worst] = True
    design = np.stack([np.ones_like(months), months])
    u_line = np.sqrt(np.einsum("in,ij,jn->n", design, covariance, design))
    typical = float(np.median(sigma))
    return Trend(
        patch, quantity, unit, time_s, value, u,
        line=level * (line[0] + line[1] * months),
        u_line=level * u_line,
        outlier=outlier,
        excess_rel=typical * math.sqrt(max(0.0, scatter**2 - 1.0)),
        drift_per_month=float(line[1] / line[0]),
        u_drift_per_month=float(math.sqrt(covariance[1, 1]) / line[0]),
    )  # fmt: skip


def _straight_line(months: Array, relative: Array, sigma: Array) -> tuple[Array, Array, float]:
    """Return intercept and slope, their covariance, and the scatter in units of the stated sigma."""
    design = np.stack([np.ones_like(months), months], axis=1) / sigma[:, None]
    normal: Array = np.linalg.inv(design.T @ design).astype(np.float64)
    solution = normal @ (design.T @ (relative / sigma))
    residual = relative / sigma - design @ solution
    scatter = math.sqrt(float(residual @ residual) / (months.size - 2))
    return solution, normal * scatter**2, scatter


def _refuse_unfit(time_s: Array, value: Array, u: Array, patch: str) -> None:
    if time_s.size < _MINIMUM_READINGS:
        raise InputError(
            f"patch {patch!r}: {time_s.size} readings are too few for a trend; it takes {_MINIMUM_READINGS}"
        )
    if not (np.all(np.isfinite(value)) and np.all(value > 0) and np.all(u > 0)):
        raise InputError(f"patch {patch!r}: readings and their uncertainties must be above 0 for a relative drift")
    if time_s[-1] - time_s[0] <= 0:
        raise InputError(f"patch {patch!r}: all readings are of one time; a drift needs a span")
