"""The rod intercept: when the threshold meets a criterion on its way down, by the line through its neighbourhood."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import t as student

from radiometer.adaptation.intervals import Interval
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

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
