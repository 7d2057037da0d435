"""Trends over months in a table of results: drift of a source or of the instrument, outliers and a control chart."""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from radiometer.archive.cycles import (
    cycle_columns,
    hidden_cycles,
    is_determined,
    near_the_season,
    slow_cycles,
    with_period,
)
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import InputError
from radiometer.typing import Array

if TYPE_CHECKING:
    import pandas as pd

MONTH_S: Final = 365.25 / 12 * 86400.0  # of the Julian year
# A drift is claimed where chance alone would show it in so many archives: 3 sigma of many readings. What is guessed of
# the correlation costs a little more, and false claims stay below one in a hundred.
CLAIM_CHANCE: Final = 0.0027
# A year's cycle is always fitted with the drift. From this part of a year on readings alone show its size. In shorter
# records it is assumed to be of any phase and of amplitudes up to some 5 % (2 % each of sine and cosine, k = 1). An
# example is a lamp of 0.3 %/K whose room is 15 K warmer in summer.
_YEAR_S: Final = 365.25 * 86400.0
_SEASON_YEARS: Final = 0.75  # three quarters of a year separate a season from a line
_SEASON_REL: Final = 0.02  # engineering prior: lamps and cameras in a room follow it by 1 to 2 %
_WITH_SEASON: Final = 4  # columns of the design: level, months, the year's sine and cosine
# Before so much of a year a change that a straight line shows may be a season's.
_REPORTED_YEARS: Final = 1.5
# Correlation times that are tried, as parts of the span; and the correlation of neighbours that counts as whole.
_TIMES_OF_SPAN: Final = np.geomspace(1e-3, 1.0, 25)
_MOST_CORRELATED: Final = 0.995  # nearer to 1 the covariance cannot be inverted in double precision
_OUTLIER_SIGMAS: Final = 4.0  # by chance once in 16 000 readings
_ROUNDS: Final = 4  # of scatter and stated sizes
_LEAST_SCATTER: Final = 1e-3  # of the stated sigma, below which stated sizes pull no less
_MOST_VALUES: Final = 4_000_000  # in a table of correlation times at once
_EARLIEST_S: Final = 631_152_000.0  # 1990-01-01: before digital cameras
_MINIMUM_READINGS: Final = 8  # twice as many as line and season have parameters


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """The history of one quantity of one patch."""

    patch: str  # name of the patch
    quantity: str  # name of the quantity
    unit: str  # its unit
    time_s: Array  # times in s since 1970, ascending, shape (n,)
    value: Array  # values, same shape
    u: Array  # stated standard uncertainties, same shape
    line: Array  # fitted straight line at the times
    u_line: Array  # standard uncertainty of the line there
    outlier: NDArray[np.bool_]  # which readings are more than 4 of their total sigmas from the line; they take no part
    excess_rel: float  # relative scatter from reading to reading beyond the stated uncertainties (k = 1)
    drift_per_month: float  # relative drift per month of 30.44 days
    u_drift_per_month: float  # its standard uncertainty, neighbours' correlation and seasons counted
    degrees_of_freedom: float = math.inf  # behind that uncertainty: of the readings' effective number
    correlation: float = 0.0  # of a reading with the next one, beyond line and season
    season_rel: float | None = None  # amplitude of the yearly cycle; None where the readings do not determine it
    straight_per_month: float = 0.0  # relative drift per month if there were no cycle that the readings do not show
    u_straight_per_month: float = math.inf  # its standard uncertainty
    # Period in s and relative amplitude of other cycles that the readings show
    cycles: tuple[tuple[float, float], ...] = ()
    # Times from which on another calibration, or other settings, were in use; in s since 1970
    changes_s: tuple[float, ...] = ()
    flags: Mapping[str, int] = field(default_factory=dict)  # how many readings bear each flag
    left_out: Mapping[str, int] = field(default_factory=dict)  # how many rows take no part, by reason

    @property
    def claim_sigmas(self) -> float:
        """Return the number of standard uncertainties from which on a drift is claimed: by Student's t."""
        return float(stats.t.ppf(1.0 - CLAIM_CHANCE / 2.0, min(self.degrees_of_freedom, 1e9)))

    @property
    def drifts(self) -> bool:
        """Return whether the drift is claimed: beyond what chance shows in fewer than one archive in a hundred."""
        return abs(self.drift_per_month) > self.claim_sigmas * self.u_drift_per_month

    @property
    def verdict(self) -> str:
        """Return "drift", "season_or_drift" for a change that a season may be as well, or "no_drift".

        The second occurs for records of less than a year and a half alone: longer ones separate the two.
        """
        if self.drifts:
            return "drift"
        season_is_known = self.time_s[-1] - self.time_s[0] >= _REPORTED_YEARS * _YEAR_S
        shown = abs(self.straight_per_month) > self.claim_sigmas * self.u_straight_per_month
        return "season_or_drift" if shown and not season_is_known else "no_drift"

    @property
    def decided_from_s(self) -> float:
        """Return from when on the record separates a season from a drift, in s since 1970."""
        return float(self.time_s[0]) + _REPORTED_YEARS * _YEAR_S

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
            "verdict": self.verdict,
            "without_season": {"value": self.straight_per_month, "u": self.u_straight_per_month, "unit": "1"},
            "degrees_of_freedom": self.degrees_of_freedom if math.isfinite(self.degrees_of_freedom) else None,
            "correlation": self.correlation,
            "season_rel": self.season_rel,
            "cycles": [{"period_days": period / 86400.0, "amplitude_rel": size} for period, size in self.cycles],
            "excess_scatter_rel": self.excess_rel,
            "left_out": dict(self.left_out),
        }


def fit_trend(time_s: Array, value: Array, u: Array, *, patch: str = "", quantity: str = "", unit: str = "") -> Trend:
    """Return the straight-line history of a quantity with the drift per month and its uncertainty.

    The stated uncertainties combine what each reading shares with the others (the calibration) and what it does not.
    Only the measured scatter shows how much is not shared. So the readings are weighted by their noise u_rel² brought
    to the scatter about the line: smaller where the readings agree better than stated, larger by an excess term where
    they agree worse. Outliers beyond 4 sigmas leave the fit, one at a time. Generalised least squares then fits the
    others. Neighbours may be correlated (exp(−Δt/τ), averaged over τ by its restricted likelihood). A yearly cycle is
    fitted with the line (of a stated size where the record is too short to show it). Cycles of other periods are
    fitted where the readings show them. Cycles about as long as the record count as far as the readings allow them.

    Args:
        time_s: Times in s, shape (n,), any order.
        value: Values, above 0.
        u: Stated standard uncertainties, above 0.

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
    season = _season(months, time_s)
    design, season_is_known = season.design, season.season_is_known
    while True:
        (solution,), _, (scatter,) = _least_squares(
            (design[~outlier] / sigma[~outlier, None])[None], (relative / sigma)[None, ~outlier], season.spread
        )
        residual = np.abs(relative - design @ solution) / (scatter * sigma)
        residual[outlier] = 0.0
        worst = int(residual.argmax())
        if residual[worst] <= _OUTLIER_SIGMAS or outlier.sum() > value.size // 4:
            break
        outlier[worst] = True
    kept = ~outlier
    of_season_s = (_YEAR_S,) if season_is_known else ()
    straight = design if season_is_known else design[:, :2]
    periods_s = hidden_cycles(straight[kept], relative[kept], sigma[kept], time_s[kept], of_season_s)
    for period in periods_s:
        more = with_period(straight, relative, sigma, time_s, period)
        straight, design = np.column_stack([straight, more]), np.column_stack([design, more])
    models = _models(design, straight, relative, sigma, time_s, kept, periods_s, season_is_known=season_is_known)
    fit, line, u_line = _averaged(models, relative, sigma, time_s, kept, season.spread)
    without = _generalised(
        np.delete(design, slice(2, _WITH_SEASON), axis=1)[kept], relative[kept], sigma[kept], time_s[kept]
    )
    own, typical = fit.solution, float(np.median(sigma))
    return Trend(
        patch, quantity, unit, time_s, value, u,
        line=level * line,
        u_line=level * u_line,
        outlier=outlier,
        excess_rel=typical * math.sqrt(max(0.0, float(scatter) ** 2 - 1.0)),
        drift_per_month=float(own[1] / own[0]),
        u_drift_per_month=float(math.sqrt(fit.covariance[1, 1]) / own[0]),
        degrees_of_freedom=fit.degrees_of_freedom,
        correlation=fit.correlation,
        season_rel=float(np.hypot(own[2], own[3]) / own[0]) if season_is_known else None,
        straight_per_month=float(without.solution[1] / without.solution[0]),
        u_straight_per_month=float(math.sqrt(without.covariance[1, 1]) / without.solution[0]),
        cycles=_amplitudes(periods_s, own),
    )  # fmt: skip


def _amplitudes(periods_s: tuple[float, ...], line: Array) -> tuple[tuple[float, float], ...]:
    """Return period in s and relative amplitude of every cycle; their columns stand last."""
    own = line[line.size - 3 * len(periods_s) :].reshape(-1, 3)[:, :2] / line[0]
    return tuple((period, float(np.hypot(*pair))) for period, pair in zip(periods_s, own, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class _Season:
    """Level, months and the year's sine and cosine as columns, how large each may be, whether readings show it."""

    design: Array
    spread: Array
    season_is_known: bool


def _season(months: Array, time_s: Array) -> _Season:
    """Return the line with its yearly cycle, of stated size where the readings do not separate it from a drift."""
    phase = 2.0 * np.pi * (time_s - time_s.mean()) / _YEAR_S
    # The cosine is 0 in the middle of the record, where the level is determined.
    design = np.stack([np.ones_like(months), months, np.sin(phase), np.cos(phase) - 1.0], axis=1)
    long = time_s[-1] - time_s[0] >= _SEASON_YEARS * _YEAR_S and time_s.size >= 2 * _MINIMUM_READINGS
    season_is_known = bool(long and is_determined(design))
    return _Season(
        design, np.array([math.inf, math.inf, *(math.inf if season_is_known else _SEASON_REL,) * 2]), season_is_known
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Solution, its covariance, degrees of freedom, and the correlation of neighbours."""

    solution: Array
    covariance: Array
    degrees_of_freedom: float
    correlation: float


def _models(
    design: Array,
    straight: Array,
    relative: Array,
    sigma: Array,
    time_s: Array,
    kept: NDArray[np.bool_],
    periods_s: tuple[float, ...],
    *,
    season_is_known: bool,
) -> list[tuple[Array, float]]:
    """Return designs at all times, and how likely each is: as fitted, with a slow cycle more, or one for the year's."""
    fitted_s = (*((_YEAR_S,) if season_is_known else ()), *periods_s)
    slow = slow_cycles(straight[kept], relative[kept], sigma[kept], time_s[kept], fitted_s)
    models = [(design, 1.0)]
    models += [(np.column_stack([design, cycle_columns(time_s, period)]), odds) for period, odds in slow]
    if season_is_known:
        others = np.delete(straight, slice(2, _WITH_SEASON), axis=1)
        near = near_the_season(others[kept], relative[kept], sigma[kept], time_s[kept], _YEAR_S)
        for period, odds in near:
            columns = cycle_columns(time_s, period)
            models.append((np.column_stack([design[:, :2], columns, design[:, _WITH_SEASON:]]), odds))
    return models


def _averaged(
    models: list[tuple[Array, float]],
    relative: Array,
    sigma: Array,
    time_s: Array,
    kept: NDArray[np.bool_],
    spread: Array,
) -> tuple[_Fit, Array, Array]:
    """Return the solution averaged over models, and their common curve with its standard uncertainty.

    Level and drift are the models' mean, with how much they differ in the covariance; other columns are the first's.
    """
    fits, curves, weights = [], [], np.array([odds for _, odds in models])
    weights /= weights.sum()
    for design, _ in models:
        size = np.concatenate([spread, np.full(design.shape[1] - spread.size, math.inf)])
        fits.append(_generalised(design[kept], relative[kept], sigma[kept], time_s[kept], size))
        curves.append(design @ fits[-1].solution)
    centre, line = fits[0].solution.copy(), weights @ np.array(curves)
    centre[:2] = sum(w * fit.solution[:2] for w, fit in zip(weights, fits, strict=True))
    offs = [fit.solution[:2] - centre[:2] for fit in fits]
    covariance = sum(
        w * (fit.covariance[:2, :2] + np.outer(off, off)) for w, fit, off in zip(weights, fits, offs, strict=True)
    )
    variance = sum(
        w * (np.einsum("in,nm,im->i", design, fit.covariance, design) + (curve - line) ** 2)
        for w, fit, curve, (design, _) in zip(weights, fits, curves, models, strict=True)
    )
    freedom, correlation = (
        float(weights @ np.array(each))
        for each in ([fit.degrees_of_freedom for fit in fits], [fit.correlation for fit in fits])
    )
    return _Fit(centre, np.asarray(covariance), freedom, correlation), line, np.sqrt(np.asarray(variance))


def _generalised(design: Array, relative: Array, sigma: Array, time_s: Array, spread: Array | None = None) -> _Fit:
    """Return the solution averaged over correlation times, each by its restricted likelihood.

    The average carries how much the solutions differ: a correlation that is guessed too short claims too much.

    Source: Patterson and Thompson 1971, Biometrika 58, 545; Hoeting et al. 1999, Statistical Science 14, 382.
    """
    gaps, span = np.diff(time_s), float(time_s[-1] - time_s[0])
    count, columns = design.shape
    spread = np.full(columns, math.inf) if spread is None else spread
    phi = np.zeros((_TIMES_OF_SPAN.size + 1, gaps.size))  # without a correlation first
    phi[1:] = np.minimum(np.exp(-gaps / (_TIMES_OF_SPAN * span)[:, None]), _MOST_CORRELATED)
    whitened = np.column_stack([design, relative]) / sigma[:, None]
    at_once = max(_MOST_VALUES // whitened.size, 1)
    parts = [_solved(whitened, phi[k : k + at_once], spread) for k in range(0, len(phi), at_once)]
    solutions, covariances, likelihoods = (np.concatenate(each) for each in zip(*parts, strict=True))
    weight = np.exp(likelihoods - likelihoods.max())
    weight /= weight.sum()
    centre = weight @ solutions
    off = solutions - centre
    covariance = np.einsum("t,tij->ij", weight, covariances + off[:, :, None] * off[:, None, :])
    mean = phi.mean(axis=1) if gaps.size else np.zeros(len(phi))
    # So many readings without correlation determine a mean as well.
    freedom = np.maximum(count * (1.0 - mean) / (1.0 + mean) - columns, 1.0)
    return _Fit(centre, covariance, float(weight @ freedom), float(weight @ mean))


def _solved(whitened: Array, phi: Array, spread: Array) -> tuple[Array, Array, Array]:
    """Return solutions, their covariances and log-likelihoods, each for one row of neighbours' correlations.

    Args:
        whitened: Columns and, as the last, values, all over sigma, shape (n, columns + 1).
        phi: Correlations of neighbours, shape (times, n - 1).
        spread: Standard deviations that the columns' sizes are known to have beforehand, shape (columns,).
    """
    root = np.sqrt(1.0 - phi**2)
    white = np.empty((len(phi), *whitened.shape))
    white[:, 0] = whitened[0]
    white[:, 1:] = (whitened[1:] - phi[:, :, None] * whitened[:-1]) / root[:, :, None]
    solutions, normals, scatters = _least_squares(white[:, :, :-1], white[:, :, -1], spread)
    information = -np.linalg.slogdet(normals / scatters[:, None, None] ** 2)[1]
    freedom = whitened.shape[0] - spread.size
    likelihoods = -freedom * np.log(scatters) - 0.5 * information - np.log(root).sum(axis=1)
    return solutions, normals, likelihoods


def _least_squares(rows: Array, values: Array, spread: Array) -> tuple[Array, Array, Array]:
    """Return solutions, their covariances, and the scatters in units of the stated sigma, of problems in a stack.

    A column of a stated size is an observation more: that it is 0 ± that size. What this weighs depends on the
    scatter, which is found again with it.

    Args:
        rows: Columns, shape (problems, n, columns).
        values: Values, shape (problems, n).
        spread: Stated sizes, infinite where there is none, shape (columns,).
    """
    known = np.isfinite(spread)
    across = rows.transpose(0, 2, 1)
    squared, normal_rows = across @ values[:, :, None], across @ rows
    freedom = max(rows.shape[1] - rows.shape[2] + int(known.sum()), 1)
    scatter = np.zeros(len(rows))
    for _ in range(_ROUNDS if known.any() else 1):
        least = np.maximum(scatter, _LEAST_SCATTER)[:, None]
        pull = np.where(known, least / np.where(known, spread, 1.0), 0.0)
        inverse: Array = np.linalg.inv(normal_rows + np.eye(spread.size) * pull[:, :, None] ** 2).astype(np.float64)
        solution = (inverse @ squared)[:, :, 0]
        residual = values - (rows @ solution[:, :, None])[:, :, 0]
        chi2 = (residual**2).sum(axis=1) + ((pull * solution) ** 2).sum(axis=1)
        scatter = np.maximum(np.sqrt(chi2 / freedom), 1e-12)
    return solution, inverse * scatter[:, None, None] ** 2, scatter


def _refuse_unfit(time_s: Array, value: Array, u: Array, patch: str) -> None:
    if time_s.size < _MINIMUM_READINGS:
        raise InputError(
            f"patch {patch!r}: {time_s.size} readings are too few for a trend; it takes {_MINIMUM_READINGS}"
        )
    if not (np.all(np.isfinite(value)) and np.all(value > 0) and np.all(u > 0)):
        raise InputError(f"patch {patch!r}: readings and their uncertainties must be above 0 for a relative drift")
    if time_s[-1] - time_s[0] <= 0:
        raise InputError(f"patch {patch!r}: all readings are of one time; a drift needs a span")


_SQLITE: Final = b"SQLite format 3\0"  # www.sqlite.org/fileformat.html, section 1.3
_LONGEST_HEADING: Final = 10_000  # bytes; a batch writes some 300, and pandas takes a minute for a million columns


@bounded_reader(error=InputError)
def read_histories(table: Path, quantity: str) -> list[Trend]:
    """Return the trend of a quantity for every patch of a table of results.

    Args:
        quantity: Such as "radiance".

    Raises:
        InputError: If the file is no such table, or a patch has too few readings.
    """
    try:
        frame = _parquet(table) if table.suffix == ".parquet" else _csv(table)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {table}: {' '.join(str(error).split())[:200]}") from error
    missing = {"captured", "quantity", "patch", "value", "u", "unit", "status"} - set(frame.columns)
    if missing:
        raise InputError(f"{table}: column {sorted(missing)[0]!r} is missing; it is no table of `radiometer batch`")
    chosen = frame[(frame["quantity"] == quantity) & (frame["status"] == "ok") & frame["captured"].notna()]
    try:
        chosen = chosen.astype(dict.fromkeys(("captured", "value", "u"), float))
    except (ValueError, TypeError) as error:
        raise InputError(f"{table}: a time, value or uncertainty is no number ({error})") from error
    if "instrument" not in chosen:  # tables of earlier versions
        chosen["instrument"] = ""
    chosen["instrument"] = chosen["instrument"].astype("string").fillna("")
    cameras = chosen.groupby(["patch", "unit"], dropna=False)["instrument"].transform("nunique")
    # Another camera is another history of a patch.
    apart = cameras > 1
    chosen.loc[apart, "patch"] = chosen["patch"].astype("string") + " by " + chosen["instrument"].replace("", "unnamed")
    histories = chosen.groupby(["patch", "unit", "instrument"], dropna=False)
    return [_history(str(name), quantity, rows) for (name, *_), rows in histories]


@bounded_reader(error=InputError, apart="pyarrow")
def _parquet(table: Path) -> pd.DataFrame:
    import pandas as pd

    return pd.read_parquet(table)


def _csv(table: Path) -> pd.DataFrame:
    import pandas as pd

    with table.open("rb") as stream:
        if stream.read(len(_SQLITE)) == _SQLITE:
            raise InputError(
                f"{table}: this is a journal of the daemon; a trend needs the table of `radiometer batch`. "
                "Of a journal, `radiometer log --plot` draws the readings"
            )
        stream.seek(0)
        if len(stream.readline(_LONGEST_HEADING + 1)) > _LONGEST_HEADING:
            raise InputError(f"{table}: its first line is longer than {_LONGEST_HEADING} bytes; this is no table")
    return pd.read_csv(table)


def _history(patch: str, quantity: str, rows: pd.DataFrame) -> Trend:
    """Return the trend of one patch, with when its settings changed and what its readings were flagged.

    A bound is no value, and a time before the archive's kind of camera or after now is that of a wrong clock.
    """
    marks = (rows["flags"] if "flags" in rows else rows["patch"].map(lambda _: "")).astype("string").fillna("")
    reasons = {
        "the time is before 1990 or in the future": ~rows["captured"].between(_EARLIEST_S, time.time() + 86_400.0),
        "saturated: the value is a lower bound": marks.str.contains(r"\bsaturated\b"),
        "below_noise: the value is an upper bound": marks.str.contains(r"\bbelow_noise\b"),
        "the value or its uncertainty is no finite number": ~np.isfinite(rows[["value", "u"]]).all(axis=1),
    }
    if {"content_hash", "job"} <= set(rows):
        reasons["copies of a capture set"] = rows["content_hash"].notna() & rows.duplicated(["content_hash", "job"])
    flags = Counter(flag for written in marks for flag in re.split(r"[\s,;|]+", str(written)) if flag)
    left_out = {reason: int(found.sum()) for reason, found in reasons.items() if found.any()}
    unit = str(rows["unit"].iloc[0])
    for found in reasons.values():
        rows = rows[~found.reindex(rows.index)]
    if left_out and len(rows) < _MINIMUM_READINGS:
        why = "; ".join(f"{count} rows: {reason}" for reason, count in left_out.items())
        raise InputError(
            f"patch {patch!r}: {len(rows)} readings are left for a trend; it takes {_MINIMUM_READINGS} ({why})"
        )
    trend = fit_trend(
        np.asarray(rows["captured"], float),
        np.asarray(rows["value"], float),
        np.asarray(rows["u"], float),
        patch=patch,
        quantity=quantity,
        unit=unit,
    )
    changes: tuple[float, ...] = ()
    if "fingerprint" in rows:  # of settings, calibration and code
        ordered = rows.sort_values("captured", kind="stable")
        marks, times = (
            ordered["fingerprint"].astype("string").fillna("").to_numpy(),
            ordered["captured"].to_numpy(float),
        )
        changes = tuple(float(t) for t in times[1:][marks[1:] != marks[:-1]])
    return replace(trend, changes_s=changes, flags=dict(flags), left_out=left_out)
