"""Law of a light source over its drive: light = a·d^g·e^(−k·d), with its misfit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from radiometer.typing import Array

LEAST_DRIVE: Final = 0.05  # of full: below it a LED's onset and a meter's noise decide
_FEWEST: Final = 5  # points: three parameters and two residuals
_COLUMNS: Final = 3


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
    """

    exponent: float
    u_exponent: float
    droop: float
    u_droop: float
    misfit_rel: float
    deviation_rel: float
    u_deviation_rel: float

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        return {
            "law": "light = a * drive^exponent * exp(-droop * drive)",
            "exponent": {"value": self.exponent, "u": self.u_exponent, "unit": "1"},
            "droop": {"value": self.droop, "u": self.u_droop, "unit": "1"},
            "deviation_at_half_drive": {"value": self.deviation_rel, "u": self.u_deviation_rel, "unit": "1"},
            "misfit_rel": self.misfit_rel,
        }


def columns_of(drive: Array) -> Array:
    """Return the columns (1, ln d, −d) of ln(light/drive), shape (n, 3)."""
    return np.column_stack([np.ones_like(drive), np.log(drive), -drive])


def fit_drive_law(drive: Array, light: Array) -> DriveLaw | None:
    """Fit the law to light over drive by least squares on ln(light/drive); relative noise is taken as constant.

    Args:
        drive: Drives over full drive, shape (n,); those below 5 % are left out.
        light: Light at each in any unit.

    Returns:
        The law; None where fewer than five drives are left.
    """
    kept = (drive >= LEAST_DRIVE) & (light > 0.0)
    if int(kept.sum()) < _FEWEST:
        return None
    columns, target = columns_of(drive[kept]), np.log(light[kept] / drive[kept])
    found, _, _, _ = np.linalg.lstsq(columns, target, rcond=None)
    residual = target - columns @ found
    variance = float(residual @ residual) / max(1, target.size - _COLUMNS)
    spread = variance * np.linalg.pinv(columns.T @ columns)
    # ln of (light(1/2)/(1/2))/(light(1)/1): −(g − 1)·ln 2 + k/2.
    half = np.array([0.0, -math.log(2.0), 0.5])
    logarithm, u_half = float(half @ found), math.sqrt(float(half @ spread @ half))
    return DriveLaw(
        1.0 + float(found[1]),
        math.sqrt(float(spread[1, 1])),
        float(found[2]),
        math.sqrt(float(spread[2, 2])),
        math.sqrt(float(np.mean(residual**2))),
        math.expm1(logarithm),
        math.exp(logarithm) * u_half,
    )
