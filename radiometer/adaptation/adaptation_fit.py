"""Chooses the branch model of a threshold series and states what the eye did, with intervals.

Any one branch, cones alone or rods alone with S2, S3 and their final level, falls ever more slowly: log threshold over
time is convex. A break is where the fall quickens again. So the rival of every model with a break is the best of all
falling convex curves, not one exponential; the deviance between the two says whether there is a break.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls

from radiometer.adaptation.branch_fit import HUBER, MODELS, REWEIGHTINGS, BranchFit, fit_model, prior_weights
from radiometer.adaptation.intervals import (
    InterceptRule,
    Interval,
    bootstrap_values,
    percentile_interval,
    profile_interval,
    rod_intercept,
)
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.errors import MeasurementError, UsageError
from radiometer.plausible import PLAUSIBLE
from radiometer.progress import Progress, unseen
from radiometer.statistics.model_choice import CLEARLY_BETTER, STATED_IS_WRONG, is_supported
from radiometer.typing import Array

SHALLOWEST_S2: Final = -0.03  # log10 units per min; a flatter line after the "break" is no rod branch
# The steepest published is about −0.3 (Lamb and Pugh 2004); beyond, wild presses make the line.
STEEPEST_S2: Final = -0.6
SETTLED_TAUS: Final = 1.5  # cones have gone 78 % of their way at the break; else rods alone are treated as both
FASTEST_CONES_MIN: Final = 0.5  # time constant of a cone branch that is seen to fall; published are 1 to 2 min
SEEN_FALL: Final = 1.0  # log10 units of it in the thresholds from which its time constant is known
LEAST_ROD_FALL: Final = 0.5  # log10 units by which rods must go below the cones for a break to be one
SLACK_MIN: Final = 1.0  # a test that ends at its criterion has its last threshold just there
GRID: Final = 2000

# Deviance that a break must be worth; measured: "adaptation_one_branch" in docs/benchmarks/adaptation.md.
LEAST_DEVIANCE: Final = STATED_IS_WRONG.gain
KNOTS: Final = 48  # of the convex curve, at quantiles of the times
# A typical eye for the statement of power (Lamb and Pugh 2004: S2 −0.24 log10 per min; cones −1.5 min⁻¹ or so).
TYPICAL_TAU_MIN: Final = 1.6
TYPICAL_S2: Final = -0.24
TYPICAL_ROD_FALL: Final = 2.0  # log10 units from the break to the rods' S3 or the end of the test
DETECTED_DEVIANCE: Final = 2.0 * LEAST_DEVIANCE  # expected deviance at which nearly every such break is found
SCANNED: Final = 30
EXACT_LOG10: Final = 1e-3  # a curve that is met within this by every threshold is exact for any purpose


@dataclass(frozen=True, slots=True)
class BreakEvidence:
    """What speaks for a break."""

    # n·ln(loss of the best falling convex curve / loss of the best model with a break), both Huber's with the latter's
    # scale; −inf where no model with a break makes sense
    deviance: float
    needed: float = LEAST_DEVIANCE  # deviance from which a break is claimed
    # A typical eye's break before this time would not be seen in thresholds at these times and of this scatter, in min;
    # None where none would be seen at all, or it was not asked for
    earliest_visible_min: float | None = None

    @property
    def shown(self) -> bool:
        """Return whether there is enough for a break."""
        return self.deviance >= self.needed


def convex_curve(time_min: Array, log_threshold: Array, weights: Array) -> Array:
    """Return the best falling convex curve at the thresholds' times.

    f(t) = c + Σ d_k·max(t_k − t, 0), all d_k ≥ 0: least squares with non-negative coefficients.

    Args:
        time_min: Times in min, ascending, shape (n,).
        log_threshold: log10 thresholds, shape (n,).
        weights: Weight of each, shape (n,).

    Source: Hildreth 1954 (J. Am. Stat. Assoc. 49, 598), convex regression; Lawson and Hanson 1974, algorithm NNLS.
    """
    knots = np.unique(np.quantile(time_min, np.linspace(0.0, 1.0, min(KNOTS, time_min.size))[1:]))
    hinges = np.maximum(knots[np.newaxis, :] - time_min[:, np.newaxis], 0.0)
    level = np.ones((time_min.size, 1))
    root = np.sqrt(weights)
    # c is free: it enters with either sign.
    columns = np.hstack([level, -level, hinges])
    found, _ = nnls(columns * root[:, np.newaxis], log_threshold * root, maxiter=50 * (knots.size + 2))
    return np.asarray(columns @ found, dtype=np.float64)


def convex_sum_of_squares(time_min: Array, log_threshold: Array, weights: Array) -> float:
    """Return the weighted sum of squares that the best falling convex curve leaves; arguments as `convex_curve`."""
    return float(weights @ (log_threshold - convex_curve(time_min, log_threshold, weights)) ** 2)


def _huber_loss(residuals: Array, prior: Array, scale: float) -> float:
    """Return the sum of residuals squared, beyond HUBER scales only in proportion (Huber 1964): a wild press is one."""
    size = np.sqrt(prior) * np.abs(residuals)
    bound = HUBER * scale
    return float(np.where(size <= bound, size**2, 2 * bound * size - bound**2).sum())


def break_evidence(with_break: BranchFit | None) -> BreakEvidence:
    """Return what speaks for a break, without the statement of power.

    Args:
        with_break: The best model with a break among those that make sense; None where none does.
    """
    if with_break is None:
        return BreakEvidence(-math.inf)
    series, count = with_break.series, with_break.series.time_min.size
    prior = prior_weights(series)
    scale = max(with_break.sigma, EXACT_LOG10)
    broken = _huber_loss(series.log_threshold - with_break.threshold(series.time_min), prior, scale)
    weights = prior
    for _ in range(REWEIGHTINGS):
        residuals = series.log_threshold - convex_curve(series.time_min, series.log_threshold, weights)
        size = np.sqrt(prior) * np.abs(residuals) / scale
        weights = prior * np.minimum(1.0, HUBER / np.maximum(size, 1e-12))
    convex = _huber_loss(residuals, prior, scale)
    floor = count * EXACT_LOG10**2
    return BreakEvidence(count * math.log((convex + floor) / (broken + floor)))


def with_power(evidence: BreakEvidence, one_branch: BranchFit) -> BreakEvidence:
    """Return evidence with the earliest break that the thresholds of a curve of one branch would show."""
    series = one_branch.series
    convex = convex_sum_of_squares(series.time_min, series.log_threshold, one_branch.weights)
    sigma = max(math.sqrt(convex / series.time_min.size), EXACT_LOG10)
    earliest = earliest_visible_break(series.time_min, sigma, float(np.ptp(series.log_threshold)))
    return replace(evidence, earliest_visible_min=earliest)


def earliest_visible_break(time_min: Array, sigma_log10: float, fall_log10: float) -> float | None:
    """Return the earliest break of a typical eye that thresholds at given times would show, in min; None for none.

    Args:
        time_min: Times in min, ascending, shape (n,).
        sigma_log10: Scatter of a threshold in log10 units.
        fall_log10: How far the thresholds fall in all: the rods cannot fall further.
    """
    count = time_min.size
    for break_min in np.linspace(time_min[0], time_min[-1], SCANNED):
        before, after = (int(np.count_nonzero(side)) for side in (time_min < break_min, time_min > break_min))
        if before < 3 or after < 3:
            continue
        curve = _typical(time_min, float(break_min), min(TYPICAL_ROD_FALL, fall_log10))
        missed = convex_sum_of_squares(time_min, curve, np.ones(count))
        if count * math.log1p(missed / (count * sigma_log10**2)) >= DETECTED_DEVIANCE:
            return float(break_min)
    return None


def _typical(time_min: Array, break_min: float, rod_fall: float) -> Array:
    """Return log10 thresholds of two branches with a break at a time in min; the cones begin two units too high."""
    cones = 2.0 * np.exp(-np.minimum(time_min, break_min) / TYPICAL_TAU_MIN)
    return np.asarray(cones + np.maximum(TYPICAL_S2 * np.maximum(time_min - break_min, 0.0), -rod_fall))


@dataclass(frozen=True, slots=True)
class FitRequest:
    """How to fit."""

    criterion: float | None = None  # log10 threshold of which the time is requested; None for none
    stimulus_u_log10: float = 0.0  # standard uncertainty of the stimulus calibration in log10 units
    bootstrap_draws: int = 200  # redraws for the intervals of derived quantities; 0 leaves them out
    confidence: float = 0.95  # probability of the intervals
    intercept: InterceptRule | None = None  # the rod intercept that belongs to the protocol; None where it reports none

    def u_shared_log10(self, series: ThresholdSeries) -> float:
        """Return the standard uncertainty that all thresholds share, in log10 units: of the stimulus and the method."""
        return math.hypot(self.stimulus_u_log10, series.u_method_log10)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with unit, standard uncertainty and two intervals (None where not made)."""

    value: float
    u: float
    unit: str
    profile: Interval | None = None
    bootstrap: Interval | None = None

    @property
    def interval(self) -> Interval | None:
        """Return the interval to state: by the profile where it was made, else by the bootstrap."""
        return self.profile or self.bootstrap

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping for JSON; an unbounded end is null."""
        mapping: dict[str, Any] = {"value": self.value, "u": _finite(self.u), "unit": self.unit}
        for name, interval in (("interval", self.interval), ("bootstrap", self.bootstrap)):
            if interval is not None:
                mapping[name] = [_finite(interval.low), _finite(interval.high)]
        return mapping


@dataclass(frozen=True, slots=True, eq=False)
class AdaptationFit:
    """What was found of an eye."""

    chosen: BranchFit  # the simplest model near the least AICc among those that make sense
    tried: tuple[BranchFit, ...]  # all fits, also those left out
    estimates: Mapping[str, Estimate]  # parameters and derived quantities by name
    # Stated log10 threshold of which the time is given; None where one branch alone does not cross it
    criterion: float | None
    verdict: str  # what the curve shows, in words
    request: FitRequest  # how it was fitted
    evidence: BreakEvidence  # what speaks for a break

    @property
    def has_break(self) -> bool:
        """Return whether a rod–cone break was found."""
        return self.chosen.has_break


def fit_adaptation(
    series: ThresholdSeries, request: FitRequest, rng: np.random.Generator, progress: Progress = unseen
) -> AdaptationFit:
    """Return the fit of the family's best member, with intervals.

    Raises:
        MeasurementError: If the series has one time alone, shows no adaptation, or none that a branch model describes.
        UsageError: If the criterion is no threshold.
    """
    if request.criterion is not None:
        PLAUSIBLE["log10_threshold"].check("criterion", request.criterion, UsageError)
    if series.time_min[0] == series.time_min[-1]:
        raise MeasurementError(f"all thresholds are of one time, {series.time_min[0]:g} min: they show no recovery")
    chosen, fits, evidence = _chosen(series)
    if not chosen.has_break:
        evidence = with_power(evidence, chosen)
    criterion = _criterion(chosen, request)
    weights = akaike_weights([fit for fit in fits if makes_sense(fit) and fit.has_break == chosen.has_break])
    draws = [
        (fit, bootstrap_values(fit, round(weight * request.bootstrap_draws), rng, progress)) for fit, weight in weights
    ]
    of_chosen = next(drawn for fit, drawn in draws if fit is chosen)
    estimates = {
        **{name: _parameter(chosen, name, of_chosen, request) for name in chosen.model.parameters},
        **_derived_estimates(weights, criterion, draws, request),
        **_intercept_estimate(series, request),
    }
    return AdaptationFit(chosen, fits, estimates, criterion, _verdict(chosen, evidence), request, evidence)


def _intercept_estimate(series: ThresholdSeries, request: FitRequest) -> dict[str, Estimate]:
    if request.intercept is None:
        return {}
    met = rod_intercept(series, request.intercept, request.u_shared_log10(series), request.confidence)
    return {} if met is None else {"rod_intercept_min": Estimate(met.time_min, met.u_min, "min", met.interval)}


def intercept_verdict(fit: AdaptationFit) -> str | None:
    """Return what the rod intercept shows, with its published limit; None where the protocol reports none."""
    rule = fit.request.intercept
    if rule is None:
        return None
    met = fit.estimates.get("rod_intercept_min")
    criterion = f"{10**rule.criterion_log10:.2g} scotopic cd·m⁻²"
    last_min = float(fit.chosen.series.time_min[-1])
    found = (
        f"rod intercept: {criterion} not reached within {last_min:.1f} min"
        if met is None
        else f"rod intercept at {criterion} after {met.value:.1f} min"
    )
    return f"{found}{_judged(rule, met, last_min)}"


def _judged(rule: InterceptRule, met: Estimate | None, last_min: float) -> str:
    """Return how an intercept compares with its published limit, or why it cannot be compared."""
    if rule.limit_min is None:
        return ""
    limit = f"the limit of {rule.limit_min:g} min ({rule.source})"
    if not rule.limit_applies:
        lasted = "lasted for an unknown time" if rule.bleach_s is None else f"lasted for {rule.bleach_s:g} s"
        return (
            f"; not judged: {limit} is for a flash of less than a millisecond, the bleach of this run {lasted}. "
            "Compare it with healthy eyes that you measured by the same protocol"
        )
    if met is None:
        return (
            f"; later than {limit}" if last_min > rule.limit_min else f"; whether it is later than {limit} is unknown"
        )
    low, high = (met.value,) * 2 if met.interval is None else (met.interval.low, met.interval.high)
    if low > rule.limit_min:
        return f"; later than {limit}"
    return f"; within {limit}" if high < rule.limit_min else f"; it cannot be distinguished from {limit}"


def best_branches(series: ThresholdSeries) -> BranchFit:
    """Return the family's best member without any interval; quick enough to follow a running test.

    Raises:
        MeasurementError: If the series shows no adaptation, or none that a branch model describes.
    """
    return _chosen(series)[0]


def _chosen(series: ThresholdSeries) -> tuple[BranchFit, tuple[BranchFit, ...], BreakEvidence]:
    """Return the best member, all that were tried, and what speaks for a break."""
    series.require_recovery()
    fits = _fit_family(series)
    sensible = [fit for fit in fits if makes_sense(fit)]
    broken = [fit for fit in sensible if fit.has_break]
    evidence = break_evidence(min(broken, key=lambda fit: fit.aicc) if broken else None)
    if broken and evidence.shown:
        return _choose(broken), fits, evidence
    return _choose([fit for fit in sensible if not fit.has_break]), fits, evidence


def _fit_family(series: ThresholdSeries) -> tuple[BranchFit, ...]:
    """Return a fit of every model that the series is long enough for, all with the weights of the fullest one.

    Sums of squares, and so AICc, compare only at the same weights; the fullest model mistakes least for an outlier.
    """
    models = [model for model in MODELS if series.time_min.size > len(model.parameters) + 2]
    fullest = fit_model(series, models[-1])
    return (*(fit_model(series, model, fullest.weights) for model in models[:-1]), fullest)


def _choose(fits: list[BranchFit]) -> BranchFit:
    """Return the simplest fit near the least AICc: more branches must be worth their parameters."""
    if not fits:
        raise MeasurementError("no branch model describes these thresholds: they rise, or jump; look at the curve")
    best = min(fit.aicc for fit in fits)
    return next(fit for fit in fits if not is_supported(fit.aicc - best, CLEARLY_BETTER))


def makes_sense(fit: BranchFit) -> bool:
    """Return whether a fit is physiological: cones that fall and are seen, rods that fall well below, S3 above S2."""
    values, times = fit.values, fit.series.time_min
    if values["amplitude"] <= 0:
        return False
    if "break_min" not in values:
        return True
    breaks = [values[name] for name in fit.model.nonlinear[1:]]
    seen = np.count_nonzero(times < breaks[0]) >= 3 and np.count_nonzero(times > breaks[-1]) >= 3
    settled = values["break_min"] >= SETTLED_TAUS * values["tau_min"]
    s3 = values.get("s3_slope_per_min", 0.0)
    fallen = values["amplitude"] * math.exp(-float(times[0]) / values["tau_min"])
    settled = settled and (fallen < SEEN_FALL or values["tau_min"] >= FASTEST_CONES_MIN)
    at_break, at_end = fit.threshold(np.array([values["break_min"], times[-1]]))
    seen = seen and at_break - at_end >= LEAST_ROD_FALL
    return bool(
        seen
        and settled
        and STEEPEST_S2 <= values["s2_slope_per_min"] <= SHALLOWEST_S2
        and values["s2_slope_per_min"] < s3 <= 0.05
    )


def derived_quantities(fit_values: Mapping[str, float], fit: BranchFit, criterion: float | None) -> dict[str, float]:
    """Return final threshold, area under the curve and, at a criterion, the time at which it is met.

    The area under the dark-adaptation curve (AUDAC) is that between the curve and its final threshold, from the first
    to the last threshold, in log10·min. The times at which it begins and is cut come with it. The intercept is where
    the S2 line, prolonged where needed, or a single branch crosses the criterion.
    """
    times = fit.series.time_min
    grid = np.linspace(times[0], times[-1], GRID)
    curve = fit.model.threshold(grid, dict(fit_values))
    final = float(curve[-1])
    derived = {
        "final_threshold": final,
        "area_log10_min": float(np.trapezoid(curve - final, grid)),
        "area_from_min": float(times[0]),
        "area_to_min": float(times[-1]),
    }
    if criterion is not None:
        derived["criterion_min"] = _crossing(fit_values, criterion)
    return derived


def _crossing(values: Mapping[str, float], criterion: float) -> float:
    """Return when S2, prolonged where needed, or a single branch crosses a criterion, in min; inf where never."""
    if "break_min" not in values:
        left = (criterion - values["plateau"]) / values["amplitude"] if values["amplitude"] else 0.0
        return -values["tau_min"] * math.log(left) if left > 0 else math.inf
    at_break = values["plateau"] + values["amplitude"] * math.exp(-values["break_min"] / values["tau_min"])
    slope = values["s2_slope_per_min"]
    return values["break_min"] + (criterion - at_break) / slope if slope < 0 else math.inf


def _steepness(values: Mapping[str, float], criterion: float | None) -> float:
    """Return how fast the threshold falls where it crosses a criterion, in log10 units per min."""
    if "break_min" in values or criterion is None:
        return abs(values.get("s2_slope_per_min", 0.0))
    return abs(criterion - values["plateau"]) / values["tau_min"]


def _criterion(fit: BranchFit, request: FitRequest) -> float | None:
    """Return the criterion: a stated one also for a single branch that crosses it within the test."""
    if fit.has_break or request.criterion is None:
        return request.criterion
    times = fit.series.time_min
    inside = times[0] < _crossing(fit.values, request.criterion) <= times[-1] + SLACK_MIN
    return request.criterion if inside else None


_UNITS: Final = {
    "plateau": "log10",
    "amplitude": "log10",
    "final_threshold": "log10",
    "s2_slope_per_min": "log10/min",
    "s3_slope_per_min": "log10/min",
    "area_log10_min": "log10 min",
}
_SHIFTED: Final = ("plateau", "final_threshold")  # what all thresholds are wrong by shifts these one to one


def _parameter(fit: BranchFit, name: str, draws: list[dict[str, float]], request: FitRequest) -> Estimate:
    profile = profile_interval(fit, name, request.confidence)
    boot = percentile_interval([draw[name] for draw in draws], request.confidence) if draws else None
    u_shared = request.u_shared_log10(fit.series) if name in _SHIFTED else 0.0
    return _estimate(name, fit.values[name], profile, boot, request, u_shared)


def akaike_weights(fits: list[BranchFit]) -> list[tuple[BranchFit, float]]:
    """Return fits with the probability of each model: exp(−ΔAICc/2), in sum 1 (Burnham and Anderson 2002, 2.9)."""
    raw = np.exp(-0.5 * (np.array([fit.aicc for fit in fits]) - min(fit.aicc for fit in fits)))
    return list(zip(fits, map(float, raw / raw.sum()), strict=True))


def _derived_estimates(
    weights: list[tuple[BranchFit, float]],
    criterion: float | None,
    draws: list[tuple[BranchFit, list[dict[str, float]]]],
    request: FitRequest,
) -> dict[str, Estimate]:
    """Return what holds for every model, averaged over them: whether S3 ends before the test does is seldom sure."""
    of_models = [(derived_quantities(fit.values, fit, criterion), weight) for fit, weight in weights]
    drawn = [derived_quantities(draw, fit, criterion) for fit, of_fit in draws for draw in of_fit]
    slope = sum(_steepness(fit.values, criterion) * weight for fit, weight in weights)
    u_log10 = request.u_shared_log10(weights[0][0].series)
    found = {}
    for name in of_models[0][0]:
        value = sum(values[name] * weight for values, weight in of_models)
        boot = percentile_interval([one[name] for one in drawn], request.confidence) if drawn else None
        # A stated criterion is absolute: a wrong stimulus scale moves the time at which it is met.
        moved = u_log10 / slope if name == "criterion_min" else 0.0
        found[name] = _estimate(name, value, None, boot, request, u_log10 if name in _SHIFTED else moved)
    return found


def _estimate(
    name: str, value: float, profile: Interval | None, boot: Interval | None, request: FitRequest, u_shared: float
) -> Estimate:
    """Return an estimate whose intervals hold the uncertainty that all thresholds share, in the estimate's unit."""
    if u_shared:
        profile, boot = (one.widened(u_shared) if one is not None else None for one in (profile, boot))
    known = profile or boot
    u = (known.high - known.low) / (2 * 1.96) if known is not None and request.confidence == 0.95 else math.nan
    return Estimate(value, u, _UNITS.get(name, "min"), profile, boot)


def _verdict(fit: BranchFit, evidence: BreakEvidence) -> str:
    values = fit.values
    if "break_min" not in values:
        earliest = evidence.earliest_visible_min
        power = (
            "with these none could be seen"
            if earliest is None
            else f"with these a break earlier than {earliest:.1f} min cannot be seen"
        )
        return f"one branch: no rod–cone break is seen in these thresholds; {power}"
    slope = values["s2_slope_per_min"]
    return f"rod–cone break at {values['break_min']:.1f} min, S2 slope {slope:.3f} log₁₀ units per min"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
