"""Whether a curve shows a rod–cone break: the fall must quicken, which no single branch does.

Any one branch, cones alone or rods alone with S2, S3 and their final level, falls ever more slowly: log threshold over
time is convex. A break is where the fall quickens again. So the rival of every model with a break is the best of all
falling convex curves, not one exponential; the deviance between the two says whether there is a break.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import nnls

from radiometer.adaptation.branch_fit import HUBER, REWEIGHTINGS, BranchFit, prior_weights
from radiometer.statistics.model_choice import STATED_IS_WRONG
from radiometer.typing import Array

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
