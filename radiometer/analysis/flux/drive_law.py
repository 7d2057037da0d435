"""Law of a light source over its drive: light = a·(d − d0)·d^(g−1)·e^(−k·d), with its misfit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize_scalar

from radiometer.analysis.reading.budget import coverage_factor
from radiometer.data import Quantity
from radiometer.typing import Array

LEAST_DRIVE: Final = 0.05  # of full: below it a LED's onset and a meter's noise decide
_FEWEST: Final = 5  # points: three parameters and two residuals
_MOST_ONSET: Final = 0.98  # of the lowest drive: at it the logarithm ends
_NOTHING: Final = 1e-18  # a sum of squares of rounding


@dataclass(frozen=True, slots=True, eq=False)
class DriveLaw:
    """A fitted law of one channel; proportional light has exponent 1, droop 0 and onset 0."""

    exponent: float  # g
    droop: float  # k: the share by which full drive gives less than the power law
    onset: float  # d0, the drive over full drive up to which there is no light; 0 where the data show none
    covariance: Array  # of the three, shape (3, 3)
    misfit_rel: float  # root mean square relative residual

    def light_over(self, drive: float, reference: float) -> Quantity:
        """Return the light at one drive over that at another, both over full drive and above the onset; u is the law's.

        ln of it is g·ln(d/r) − k·(d − r) + ln(1 − d0/d) − ln(1 − d0/r).
        """
        logarithm = self.exponent * math.log(drive / reference) - self.droop * (drive - reference)
        logarithm += math.log1p(-self.onset / drive) - math.log1p(-self.onset / reference)
        of_onset = 1.0 / (reference - self.onset) - 1.0 / (drive - self.onset)
        slope = np.array([math.log(drive / reference), reference - drive, of_onset])
        u = math.sqrt(max(0.0, float(slope @ self.covariance @ slope)))
        return Quantity(math.exp(logarithm), math.exp(logarithm) * u, "1")

    @property
    def parameters(self) -> dict[str, Quantity]:
        """Return exponent, droop, onset, and light at half drive over half of the light at full drive, less 1."""
        half, u = self.light_over(0.5, 1.0).scaled(2.0, "1"), np.sqrt(np.diag(self.covariance)).tolist()
        named = {
            name: Quantity(getattr(self, name), u[n], "1") for n, name in enumerate(("exponent", "droop", "onset"))
        }
        return {**named, "deviation_at_half_drive": Quantity(half.value - 1.0, half.u, "1")}

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        return {
            "law": "light = a * (drive - onset) * drive^(exponent - 1) * exp(-droop * drive)",
            **{name: one.to_mapping() for name, one in self.parameters.items()},
            "misfit_rel": self.misfit_rel,
        }

    def __str__(self) -> str:
        known = self.parameters
        onset = f"onset {known['onset'].scaled(100.0, '%').text()}, " if self.onset else ""
        half = known["deviation_at_half_drive"].scaled(100.0, "%").text()
        return (
            f"exponent {known['exponent'].text()}, droop {known['droop'].text()}, {onset}"
            f"half drive {half} off proportional (k = 2), misfit {100 * self.misfit_rel:.2g} %"
        )


def columns_of(drive: Array) -> Array:
    """Return the columns (1, ln d, −d) of ln(light/drive), shape (n, 3)."""
    return np.column_stack([np.ones_like(drive), np.log(drive), -drive])


def fit_drive_law(drive: Array, light: Array, ranges: Array | None = None) -> DriveLaw | None:
    """Fit the law to light over drive by least squares on ln(light/drive); relative noise is taken as constant.

    Drives, shape (n,), are over full drive; those below 5 % are left out. None where fewer than five are left. An onset
    counts where it pays for its parameter by the criterion of Schwarz (1978). The range that a meter read each light
    in, numbered from 0, shape (n,), gives each range its factor.
    """
    kept = (drive >= LEAST_DRIVE) & (light > 0.0)
    if int(kept.sum()) < _FEWEST:
        return None
    d = drive[kept]
    columns, target = columns_of(d), np.log(light[kept] / d)
    if ranges is not None:
        numbers = np.unique(ranges[kept])
        columns = np.column_stack([columns, ranges[kept, None] == numbers[None, 1:]])
        if target.size < columns.shape[1] + 2:
            return None

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
    # Drives that show no onset may hide a small one: the covariance is with it in any case, for k = 2 by Student's t.
    moved = np.column_stack([columns, -1.0 / (d - onset)])
    found, residual = solved(onset)
    freedom = size - moved.shape[1]
    variance = float(residual @ residual) / freedom * (coverage_factor(freedom) / 2.0) ** 2
    own = np.ix_([1, 2, -1], [1, 2, -1])  # exponent, droop and onset
    covariance = variance * np.linalg.pinv(moved.T @ moved, hermitian=True)[own]
    return DriveLaw(1.0 + float(found[1]), float(found[2]), onset, covariance, math.sqrt(float(np.mean(residual**2))))
