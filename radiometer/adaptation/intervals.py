"""Intervals of a fit's parameters (profile likelihood, residual bootstrap), and the rod intercept with its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.stats import f as f_distribution
from scipy.stats import t as student

from radiometer.adaptation.branch_fit import HUBER_CONSISTENCY, BranchFit, project, refine
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.progress import Progress, unseen
from radiometer.statistics.least_squares import solve
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

# Measured: over 500 simulated subjects (69 thresholds, 3 nonlinear parameters) the mean likelihood ratio of the truth
# was 1.11 ± 0.03 of its limit, averaged over the 7 parameters. These are other subjects than those of the benchmark.
BARTLETT: Final = 2.6
_K_95: Final = 1.96  # standard deviations of a normal distribution on either side of 95 % of it


@dataclass(frozen=True, slots=True)
class Interval:
    """A two-sided interval; an end is infinite where the data do not bound it."""

    low: float
    high: float

    @property
    def is_closed(self) -> bool:
        """Return whether the data bound both ends."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def holds(self, value: float) -> bool:
        """Return whether a value is inside."""
        return self.low <= value <= self.high

    def widened(self, u: float) -> Interval:
        """Return the interval with a further standard uncertainty added to each side in quadrature."""
        middle = 0.5 * (self.low + self.high)
        half = float(np.hypot(0.5 * (self.high - self.low), _K_95 * u))
        return Interval(middle - half, middle + half)


def profile_interval(fit: BranchFit, name: str, confidence: float = 0.95) -> Interval:
    """Return the profile-likelihood interval of a parameter.

    Values whose least sum of squares stays below S_min + s²·F(1, n − p)·(1 + BARTLETT·k/n), k the number of nonlinear
    parameters and s² the robust variance. The last factor is Bartlett's: at small n the likelihood ratio of a curved
    model is larger on average than its limit.

    Source: Bates and Watts 1988, Nonlinear Regression Analysis, section 6.1; Bartlett 1937, Proc. R. Soc. A 160, 268.
    """
    dof = fit.degrees_of_freedom
    factor = 1 + BARTLETT * len(fit.model.nonlinear) / fit.series.time_min.size
    limit = fit.sum_of_squares + fit.sigma**2 * float(f_distribution.ppf(confidence, 1, dof)) * factor
    best = fit.values[name]
    scale = max(abs(best), 0.1) * 0.05
    return Interval(_end(fit, name, best, -scale, limit), _end(fit, name, best, scale, limit))


def bootstrap_values(
    fit: BranchFit, draws: int, rng: np.random.Generator, progress: Progress = unseen
) -> list[dict[str, float]]:
    """Return the parameters of fits to the fitted curve plus redrawn residuals.

    Residuals are drawn with replacement, scaled to the robust standard deviation, at the fit's weights.

    Source: Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapter 9.
    """
    series, model = fit.series, fit.model
    curve = fit.threshold(series.time_min)
    residuals = np.sqrt(fit.weights) * (series.log_threshold - curve)
    residuals = (residuals - residuals.mean()) * np.sqrt(residuals.size / (fit.degrees_of_freedom * HUBER_CONSISTENCY))
    start = np.array([fit.values[name] for name in model.nonlinear])
    found = []
    for done in range(draws):
        progress("redrawing for the intervals", done, draws)
        drawn = curve + rng.choice(residuals, residuals.size) / np.sqrt(fit.weights)
        nonlinear = refine(series.time_min, drawn, model, fit.weights, start)
        _, linear = project(series.time_min, drawn, model, fit.weights, nonlinear)
        found.append(dict(zip(model.parameters, map(float, (*linear, *nonlinear)), strict=True)))
    return found


def percentile_interval(values: list[float], confidence: float = 0.95) -> Interval:
    """Return the percentile interval of bootstrap values."""
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile([value for value in values if np.isfinite(value)] or [np.nan], [tail, 100.0 - tail])
    return Interval(float(low), float(high))


def _end(fit: BranchFit, name: str, best: float, step: float, limit: float) -> float:
    """Return where the profile crosses the limit on one side; infinite where it does not within 60 growing steps."""
    start = np.array([fit.values[n] for n in fit.model.nonlinear])
    inner = best
    for _ in range(60):
        outer = inner + step
        total, nonlinear = _profile(fit, name, outer, start)
        if total > limit:
            if _excess(fit, name, start, limit, inner) >= 0.0:  # without noise: nothing but rounding is between
                return inner
            return float(brentq(partial(_excess, fit, name, start, limit), inner, outer, xtol=1e-4))
        start, inner, step = nonlinear, outer, 1.3 * step
    return float(np.copysign(np.inf, step))


def _excess(fit: BranchFit, name: str, start: Array, limit: float, value: float) -> float:
    return _profile(fit, name, value, start)[0] - limit


def _profile(fit: BranchFit, name: str, value: float, start: Array) -> tuple[float, Array]:
    """Return the least sum of squares with one parameter held, and the nonlinear parameters there."""
    if name in fit.model.linear:
        return _held_linear(fit, fit.model.linear.index(name), value, start)
    return _held_nonlinear(fit, fit.model.nonlinear.index(name), value, start)


def _held_linear(fit: BranchFit, column: int, value: float, start: Array) -> tuple[float, Array]:
    series, model, weights = fit.series, fit.model, fit.weights
    free = [index for index in range(len(model.linear)) if index != column]

    def cost(nonlinear: Any) -> float:
        if not model.allowed(series.time_min, nonlinear):
            return 1e12
        basis = model.basis(series.time_min, nonlinear)
        target = series.log_threshold - value * basis[:, column]
        linear = solve(basis[:, free], target, weights)
        return float(weights @ (target - basis[:, free] @ linear) ** 2)

    return _minimum(cost, start)


def _held_nonlinear(fit: BranchFit, position: int, value: float, start: Array) -> tuple[float, Array]:
    series, model = fit.series, fit.model

    def full(free: Array) -> Array:
        return np.insert(free, position, value)

    def cost(free: Any) -> float:
        nonlinear = full(free)
        if not model.allowed(series.time_min, nonlinear):
            return 1e12
        return project(series.time_min, series.log_threshold, model, fit.weights, nonlinear)[0]

    free = np.delete(start, position)
    if free.size == 0:
        return cost(free), full(free)
    total, found = _minimum(cost, free)
    return total, full(found)


def _minimum(cost: Callable[[Any], float], start: Array) -> tuple[float, Array]:
    found = minimize(
        cost, np.ravel(start), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-7, "maxiter": 200}
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)


WINDOW_MIN: Final = 3.0  # on either side: 0.7 log10 units of a healthy S2, within which it is straight
FEWEST: Final = 5
HUBER: Final = 1.5
ROUNDS: Final = 5
LIMIT_FLASH_S: Final = 1e-3  # the published tests' flash lasts less (0.25 ms; Jackson and Edwards 2008)


@dataclass(frozen=True, slots=True)
class InterceptRule:
    """What belongs to a rod intercept."""

    criterion_log10: float  # the criterion, log10 of scotopic cd·m⁻²
    limit_min: float | None = None  # published limit in min; None where there is none
    source: str = ""  # where criterion and limit come from
    bleach_s: float | None = None  # how long the run's bleach lasted in s; None where it is not known

    @property
    def limit_applies(self) -> bool:
        """Return whether the run's bleach is of the kind for which the limit was published: a flash."""
        return self.limit_min is not None and self.bleach_s is not None and self.bleach_s <= LIMIT_FLASH_S


@dataclass(frozen=True, slots=True)
class RodIntercept:
    """When the criterion is met: time in min, standard uncertainty and interval."""

    time_min: float
    u_min: float
    interval: Interval


def rod_intercept(
    series: ThresholdSeries, rule: InterceptRule, u_shared_log10: float = 0.0, confidence: float = 0.95
) -> RodIntercept | None:
    """Return when the eye's threshold meets the criterion; None where it does not within the thresholds.

    A robust straight line through the thresholds within 3 min of the first crossing, read backwards.

    Args:
        u_shared_log10: Standard uncertainty that all thresholds share, log10 units.
    """
    target = rule.criterion_log10
    times, levels = series.time_min, series.log_threshold
    crossing = _first_crossing(times, levels, target)
    if crossing is None:
        return None
    near = np.abs(times - crossing) <= WINDOW_MIN
    if np.count_nonzero(near) < FEWEST:
        near = np.isin(np.arange(times.size), np.argsort(np.abs(times - crossing))[:FEWEST])
    return _read_back(times[near], levels[near], target, u_shared_log10, confidence)


def _first_crossing(times: Array, levels: Array, target: float) -> float | None:
    """Return where the median of three first falls to the target and the next one stays there."""
    if levels.size < FEWEST:
        return None
    smooth = np.array([np.median(levels[max(0, n - 1) : n + 2]) for n in range(levels.size)])
    below = smooth <= target
    below[:-1] &= below[1:]
    if not below.any() or below[0]:
        return None
    return float(times[int(np.argmax(below))])


def _read_back(times: Array, levels: Array, target: float, u_level: float, confidence: float) -> RodIntercept | None:
    weights = np.ones(times.size)
    for _ in range(ROUNDS):
        slope, level = np.polyfit(times, levels, 1, w=np.sqrt(weights))
        residuals = np.abs(levels - slope * times - level)
        scale = max(robust_sigma(residuals, 0.0), 1e-6)
        weights = np.minimum(1.0, HUBER * scale / np.maximum(residuals, 1e-12))
    if slope >= 0:
        return None
    found = (target - level) / slope
    dof = times.size - 2
    variance = float(weights @ residuals**2) / dof
    middle = float(np.average(times, weights=weights))
    spread = float(weights @ (times - middle) ** 2)
    own = variance * (1.0 / float(weights.sum()) + (found - middle) ** 2 / spread)
    u_min = math.sqrt(own + u_level**2) / abs(slope)
    half = float(student.ppf(0.5 + confidence / 2, dof)) * math.sqrt(own) / abs(slope)
    half = math.hypot(half, 1.96 * u_level / abs(slope))
    return RodIntercept(float(found), u_min, Interval(found - half, found + half))
