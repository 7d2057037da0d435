"""Trends over months: drift of a source or of the instrument, with outliers and a control chart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from radiometer.archive.cycles import hidden_cycles, slow_cycles, tells_apart, with_period
from radiometer.errors import InputError

MONTH_S: Final = 365.25 / 12 * 86400.0
# A drift is claimed where chance alone would show it in so many archives: 3 sigma of many readings. What is guessed of
# the correlation costs a little more, and false claims stay below one in a hundred.
CLAIM_CHANCE: Final = 0.0027
# From this part of a year on a season can be told from a drift, and is fitted beside it.
_YEAR_S: Final = 365.25 * 86400.0
_SEASON_YEARS: Final = 0.9
_WITH_SEASON: Final = 4  # columns of the design: level, months, sine and cosine of the year
# Correlation times that are tried, as parts of the span; and the correlation of neighbours that counts as whole.
_TIMES_OF_SPAN: Final = np.geomspace(1e-3, 1.0, 25)
_MOST_CORRELATED: Final = 0.995
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
        u_drift_per_month: Its standard uncertainty, neighbours' correlation and seasons counted.
        degrees_of_freedom: Behind that uncertainty: of the readings' effective number.
        correlation: Of a reading with the next one, beyond line and season.
        season_rel: Amplitude of the yearly cycle; None where the span is too short to tell it from a drift.
        cycles: Period in s and relative amplitude of other cycles that the readings show.
        changes_s: Times from which on another calibration, or other settings, were in use; in s since 1970.
        flags: How many readings bear each flag.
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
    degrees_of_freedom: float = math.inf
    correlation: float = 0.0
    season_rel: float | None = None
    cycles: tuple[tuple[float, float], ...] = ()
    changes_s: tuple[float, ...] = ()
    flags: Mapping[str, int] = field(default_factory=dict)

    @property
    def claim_sigmas(self) -> float:
        """Return the number of standard uncertainties from which on a drift is claimed: by Student's t."""
        return float(stats.t.ppf(1.0 - CLAIM_CHANCE / 2.0, min(self.degrees_of_freedom, 1e9)))

    @property
    def drifts(self) -> bool:
        """Tell whether the drift is claimed: beyond what chance shows in fewer than one archive in a hundred."""
        return abs(self.drift_per_month) > self.claim_sigmas * self.u_drift_per_month

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
            "degrees_of_freedom": self.degrees_of_freedom if math.isfinite(self.degrees_of_freedom) else None,
            "correlation": self.correlation,
            "season_rel": self.season_rel,
            "cycles": [{"period_days": period / 86400.0, "amplitude_rel": size} for period, size in self.cycles],
            "excess_scatter_rel": self.excess_rel,
        }


def fit_trend(time_s: Array, value: Array, u: Array, *, patch: str = "", quantity: str = "", unit: str = "") -> Trend:
    """Return the straight-line history of a quantity with the drift per month and its uncertainty.

    The stated uncertainties hold what each reading shares with the others (the calibration) and what it does not;
    only the scatter that is seen tells how much is not shared. So the readings are weighed by their own noise
    u_rel² brought to the scatter about the line: smaller where the readings agree better than stated, larger by an
    excess term where they agree worse. Outliers beyond 4 sigmas leave the fit, one at a time. What is left then goes
    through generalised least squares: neighbours may be correlated (exp(−Δt/τ), averaged over τ by its restricted
    likelihood), a yearly cycle is fitted beside the line where the span tells them apart, and cycles of other periods
    where the readings show them.

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
    design = _design(months, time_s)
    while True:
        solution, _, scatter = _least_squares(design[~outlier], relative[~outlier], sigma[~outlier])
        residual = np.abs(relative - design @ solution) / (scatter * sigma)
        residual[outlier] = 0.0
        worst = int(residual.argmax())
        if residual[worst] <= _OUTLIER_SIGMAS or outlier.sum() > value.size // 4:
            break
        outlier[worst] = True
    kept = ~outlier
    season_s = (_YEAR_S,) if design.shape[1] == _WITH_SEASON else ()
    periods_s = hidden_cycles(design[kept], relative[kept], sigma[kept], time_s[kept], season_s)
    for period in periods_s:
        design = np.column_stack([design, with_period(design, relative, sigma, time_s, period)])
    fit = _over_slow_cycles(design[kept], relative[kept], sigma[kept], time_s[kept], (*season_s, *periods_s))
    line, covariance = fit.solution, fit.covariance
    straight = design[:, :2]
    u_line = np.sqrt(np.einsum("in,nm,im->i", straight, covariance[:2, :2], straight))
    typical = float(np.median(sigma))
    return Trend(
        patch, quantity, unit, time_s, value, u,
        line=level * (design @ line),
        u_line=level * u_line,
        outlier=outlier,
        excess_rel=typical * math.sqrt(max(0.0, scatter**2 - 1.0)),
        drift_per_month=float(line[1] / line[0]),
        u_drift_per_month=float(math.sqrt(covariance[1, 1]) / line[0]),
        degrees_of_freedom=fit.degrees_of_freedom,
        correlation=fit.correlation,
        season_rel=float(np.hypot(line[2], line[3]) / line[0]) if season_s else None,
        cycles=_amplitudes(periods_s, line),
    )  # fmt: skip


def _amplitudes(periods_s: tuple[float, ...], line: Array) -> tuple[tuple[float, float], ...]:
    """Return period in s and relative amplitude of every cycle; their columns stand last."""
    own = line[line.size - 3 * len(periods_s) :].reshape(-1, 3)[:, :2] / line[0]
    return tuple((period, float(np.hypot(*pair))) for period, pair in zip(periods_s, own, strict=True))


def _design(months: Array, time_s: Array) -> Array:
    """Return the columns level, months, and the year's sine and cosine where the span tells them from a drift."""
    columns = [np.ones_like(months), months]
    if time_s[-1] - time_s[0] >= _SEASON_YEARS * _YEAR_S and time_s.size >= 2 * _MINIMUM_READINGS:
        phase = 2.0 * np.pi * (time_s - time_s[0]) / _YEAR_S
        yearly = [*columns, np.sin(phase), np.cos(phase)]
        columns = yearly if tells_apart(np.stack(yearly, axis=1)) else columns
    return np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Solution, its covariance, degrees of freedom, and the correlation of neighbours."""

    solution: Array
    covariance: Array
    degrees_of_freedom: float
    correlation: float


def _over_slow_cycles(design: Array, relative: Array, sigma: Array, time_s: Array, fitted_s: tuple[float, ...]) -> _Fit:
    """Return the solution averaged over models with and without a slow cycle more, its columns left out."""
    columns = design.shape[1]
    models = slow_cycles(design, relative, sigma, time_s, fitted_s)
    fits = [(_generalised(one, relative, sigma, time_s), weight) for one, weight in models]
    whole = sum(weight for _, weight in fits)
    centre = sum(weight / whole * fit.solution[:columns] for fit, weight in fits)
    covariance = sum(
        weight / whole * (fit.covariance[:columns, :columns] + np.outer(off, off))
        for fit, weight, off in ((fit, weight, fit.solution[:columns] - centre) for fit, weight in fits)
    )
    freedom = sum(weight / whole * fit.degrees_of_freedom for fit, weight in fits)
    correlation = sum(weight / whole * fit.correlation for fit, weight in fits)
    return _Fit(np.asarray(centre), np.asarray(covariance), float(freedom), float(correlation))


def _generalised(design: Array, relative: Array, sigma: Array, time_s: Array) -> _Fit:
    """Return the solution averaged over correlation times, each by its restricted likelihood.

    The average carries how much the solutions differ: a correlation that is guessed too short claims too much.

    Source: Patterson and Thompson 1971, Biometrika 58, 545; Hoeting et al. 1999, Statistical Science 14, 382.
    """
    gaps, span = np.diff(time_s), float(time_s[-1] - time_s[0])
    count, columns = design.shape
    fits, likelihoods = [], []
    for tau in (0.0, *(_TIMES_OF_SPAN * span)):
        phi = np.zeros_like(gaps) if tau == 0.0 else np.minimum(np.exp(-gaps / tau), _MOST_CORRELATED)
        rows, told, jacobian = _whitened(design / sigma[:, None], relative / sigma, phi)
        solution, normal, scatter = _least_squares(rows, told, np.ones(count))
        information = np.linalg.slogdet(rows.T @ rows)[1]
        likelihoods.append(-(count - columns) * math.log(scatter) - 0.5 * information + jacobian)
        mean = float(phi.mean()) if phi.size else 0.0
        # So many readings without correlation tell as much of a mean.
        effective = count * (1.0 - mean) / (1.0 + mean)
        fits.append(_Fit(solution, normal, max(effective - columns, 1.0), mean))
    weight = np.exp(np.array(likelihoods) - max(likelihoods))
    weight /= weight.sum()
    centre = sum(w * fit.solution for w, fit in zip(weight, fits, strict=True))
    covariance = sum(
        w * (fit.covariance + np.outer(fit.solution - centre, fit.solution - centre))
        for w, fit in zip(weight, fits, strict=True)
    )
    freedom = float(weight @ [fit.degrees_of_freedom for fit in fits])
    return _Fit(np.asarray(centre), np.asarray(covariance), freedom, float(weight @ [fit.correlation for fit in fits]))


def _whitened(rows: Array, told: Array, phi: Array) -> tuple[Array, Array, float]:
    """Return rows and values without the correlation of neighbours, and the logarithm of what that divides by."""
    root = np.sqrt(1.0 - phi**2)
    apart = np.concatenate([rows[:1], (rows[1:] - phi[:, None] * rows[:-1]) / root[:, None]])
    values = np.concatenate([told[:1], (told[1:] - phi * told[:-1]) / root])
    return apart, values, -float(np.log(root).sum())


def _least_squares(design: Array, relative: Array, sigma: Array) -> tuple[Array, Array, float]:
    """Return the solution, its covariance, and the scatter in units of the stated sigma."""
    weighed = design / sigma[:, None]
    normal: Array = np.linalg.inv(weighed.T @ weighed).astype(np.float64)
    solution = normal @ (weighed.T @ (relative / sigma))
    residual = relative / sigma - weighed @ solution
    scatter = max(math.sqrt(float(residual @ residual) / max(design.shape[0] - design.shape[1], 1)), 1e-12)
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
