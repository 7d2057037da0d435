"""Law of a light source over its drive: light = a·(d − d0)·d^(g−1)·e^(−k·d), with its misfit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize_scalar

from radiometer.typing import Array

LEAST_DRIVE: Final = 0.05  # of full: below it a LED's onset and a meter's noise decide
_FEWEST: Final = 5  # points: three parameters and two residuals
_COLUMNS: Final = 3
_MOST_ONSET: Final = 0.98  # of the lowest drive: at it the logarithm ends
_NOTHING: Final = 1e-18  # a sum of squares of rounding


@dataclass(frozen=True, slots=True)
class DriveLaw:
    """A fitted law of one channel; proportional light has exponent 1 and droop 0.

    Attributes:
        exponent: g.
        u_exponent: Its standard uncertainty.
        droop: k: the share by which full drive gives less than the power law.
        u_droop: Its standard uncertainty.
        misfit_rel: Root mean square relative residual.
        deviation_rel: Light at half drive over half of the light at full drive, less 1; 0 where proportional.
        u_deviation_rel: Its standard uncertainty.
        onset: d0, the drive over full drive up to which there is no light; 0 where the data show none.
        u_onset: Its standard uncertainty.
    """

    exponent: float
    u_exponent: float
    droop: float
    u_droop: float
    misfit_rel: float
    deviation_rel: float
    u_deviation_rel: float
    onset: float = 0.0
    u_onset: float = 0.0

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        return {
            "law": "light = a * (drive - onset) * drive^(exponent - 1) * exp(-droop * drive)",
            "exponent": {"value": self.exponent, "u": self.u_exponent, "unit": "1"},
            "droop": {"value": self.droop, "u": self.u_droop, "unit": "1"},
            "deviation_at_half_drive": {"value": self.deviation_rel, "u": self.u_deviation_rel, "unit": "1"},
            "onset": {"value": self.onset, "u": self.u_onset, "unit": "1"},
            "misfit_rel": self.misfit_rel,
        }


def columns_of(drive: Array) -> Array:
    """Return the columns (1, ln d, −d) of ln(light/drive), shape (n, 3)."""
    return np.column_stack([np.ones_like(drive), np.log(drive), -drive])


def fit_drive_law(drive: Array, light: Array) -> DriveLaw | None:
    """Fit the law to light over drive by least squares on ln(light/drive); relative noise is taken as constant.

    An onset counts where it pays for its parameter by the criterion of Schwarz (1978).

    Args:
        drive: Drives over full drive, shape (n,); those below 5 % are left out.
        light: Light at each in any unit.

    Returns:
        The law; None where fewer than five drives are left.
    """
    kept = (drive >= LEAST_DRIVE) & (light > 0.0)
    if int(kept.sum()) < _FEWEST:
        return None
    d = drive[kept]
    columns, target = columns_of(d), np.log(light[kept] / d)

    def solved(onset: float) -> tuple[Array, Array]:
        level = target - np.log1p(-onset / d)
        found = np.linalg.lstsq(columns, level, rcond=None)[0]
        return found, level - columns @ found

    def squares(onset: float) -> float:
        residual = solved(onset)[1]
        return float(residual @ residual)

    onset = float(minimize_scalar(squares, bounds=(0.0, _MOST_ONSET * float(d.min())), method="bounded").x)
    size = target.size
    if size * math.log((squares(0.0) + _NOTHING) / (squares(onset) + _NOTHING)) < 2.0 * math.log(size):
        onset = 0.0
    moved = np.column_stack([columns, -1.0 / (d - onset)]) if onset else columns
    found, residual = solved(onset)
    variance = float(residual @ residual) / max(1, size - moved.shape[1])
    spread = variance * np.linalg.pinv(moved.T @ moved)
    # ln of (light(1/2)/(1/2))/(light(1)/1): −(g − 1)·ln 2 + k/2 + ln(1 − 2·d0) − ln(1 − d0).
    half = np.array([0.0, -math.log(2.0), 0.5, 1.0 / (1.0 - onset) - 2.0 / (1.0 - 2.0 * onset)])[: moved.shape[1]]
    logarithm = float(half[:_COLUMNS] @ found) + math.log1p(-2.0 * onset) - math.log1p(-onset)
    u_half = math.sqrt(float(half @ spread @ half))
    return DriveLaw(
        1.0 + float(found[1]),
        math.sqrt(float(spread[1, 1])),
        float(found[2]),
        math.sqrt(float(spread[2, 2])),
        math.sqrt(float(np.mean(residual**2))),
        math.expm1(logarithm),
        math.exp(logarithm) * u_half,
        onset,
        math.sqrt(float(spread[3, 3])) if onset else 0.0,
    )
