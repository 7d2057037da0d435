"""Facts that a table of thresholds states of its run, so that its fit reports what belongs to that protocol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

import radiometer
from radiometer.adaptation.intervals import InterceptRule
from radiometer.adaptation.outcome import Reliability
from radiometer.adaptation.protocol import (
    AdaptationProtocol,
    DownUpMethod,
    LimitsMethod,
    QuestPlusMethod,
    StaircaseMethod,
)
from radiometer.adaptation.threshold_files import number_of

LEVEL_UNIT: Final = "scotopic cd·m⁻²"  # of which a run's levels and thresholds are log₁₀

# Exponents of the Weibull function of detection that are usual, and the most usual one (Watson and Pelli 1983).
SLOPES: Final = (2.5, 3.5, 5.0)
PHASES: Final = 8  # of the grid of levels against the threshold, over which the bias is averaged
LONGEST: Final = 80  # blinks, far beyond the end of any search


@dataclass(frozen=True, slots=True)
class MethodBias:
    """Mean of the threshold found less the level that is seen in 63 % of the blinks, and its u, log10 units."""

    log10: float
    u_log10: float


def method_bias(method: LimitsMethod | StaircaseMethod | DownUpMethod | QuestPlusMethod) -> MethodBias | None:
    """Return the bias of a method that takes the first level seen; None for the others, which aim at the 63 % point.

    Exact for a usual psychometric function, averaged over the places of the levels. Its uncertainty is the root mean
    square of what other usual slopes change.
    """
    if isinstance(method, LimitsMethod):
        biases = [_ascent(slope, method.step_log10, method.start_below_log10) for slope in SLOPES]
    elif isinstance(method, DownUpMethod):
        biases = [_down_up(slope, method) for slope in SLOPES]
    else:
        return None
    return MethodBias(biases[1], float(np.sqrt(np.mean(np.square(np.array(biases) - biases[1])))))


def _seen(level: float, slope: float) -> float:
    """Return the chance that a level is seen, log10 units above the threshold: 1 − exp(−10^(β·level))."""
    return 1.0 - math.exp(-(10.0 ** min(slope * level, 3.0)))


def _first_seen(start: float, step: float, slope: float) -> float:
    """Return the mean of the first level seen on the way up."""
    left, mean, level = 1.0, 0.0, start
    for _ in range(LONGEST):
        mean += left * _seen(level, slope) * level
        left *= 1.0 - _seen(level, slope)
        level += step
    return mean


def _ascent(slope: float, step: float, below: float) -> float:
    # The last threshold itself scatters about its mean; what the start adds is far below the threshold in any case.
    mean = -0.05
    for _ in range(4):
        starts = mean - below - step * (np.arange(PHASES) + 0.5) / PHASES
        mean = float(np.mean([_first_seen(float(start), step, slope) for start in starts]))
    return mean


def _down_up(slope: float, method: DownUpMethod) -> float:
    mean = 0.0
    for _ in range(4):
        starts = mean + method.start_above_log10 - method.up_log10 * (np.arange(PHASES) + 0.5) / PHASES
        mean = float(np.mean([_from_above(float(start), slope, method) for start in starts]))
    return mean


def _from_above(start: float, slope: float, method: DownUpMethod) -> float:
    left, mean, level = 1.0, 0.0, start
    for _ in range(LONGEST // 4):
        missed = left * (1.0 - _seen(level, slope))
        mean += missed * _first_seen(level + method.up_log10, method.up_log10, slope)
        left *= _seen(level, slope)
        level -= method.down_log10
    return mean


def facts_of(
    protocol: AdaptationProtocol,
    u_scale_log10: float | None = None,
    reliability: Reliability | None = None,
    visit: Mapping[str, str | float] | None = None,
) -> dict[str, str]:
    """Return the lines that stand before the thresholds of a run, by name.

    Args:
        protocol: What was done.
        u_scale_log10: Standard uncertainty that all levels share, log10 units; None where it is not known.
        reliability: Counts of false alarms, lapses and looks away; None where they are not known.
        visit: What is known of subject and visit, by name.
    """
    facts = {name: str(value) for name, value in (visit or {}).items()}
    facts |= {"protocol": protocol.name, "program": f"radiometer {radiometer.__version__}"}
    facts["level_unit"] = LEVEL_UNIT
    if protocol.shows != "break":
        facts["shows"] = protocol.shows
    bias = method_bias(protocol.method)
    if bias is not None:
        facts |= {"method_bias_log10": f"{bias.log10:.4f}", "u_method_bias_log10": f"{bias.u_log10:.4f}"}
    if u_scale_log10:
        facts["u_scale_log10"] = f"{u_scale_log10:.4f}"
    if protocol.intercept is not None:
        rule = protocol.intercept
        facts |= {
            "intercept_criterion_log10": f"{rule.criterion_log10:.4f}",
            "intercept_limit_min": f"{rule.limit_min:g}",
            "intercept_source": rule.source,
            "intercept_bleach_s": f"{protocol.bleach.duration_s:g}",
        }
    return facts if reliability is None else facts | reliability.facts()


def intercept_of(facts: Mapping[str, str]) -> InterceptRule | None:
    """Return the rod intercept that belongs to a run by its facts; None where its protocol reports none."""
    criterion = number_of(facts, "intercept_criterion_log10")
    if criterion is None:
        return None
    return InterceptRule(
        criterion,
        number_of(facts, "intercept_limit_min"),
        facts.get("intercept_source", ""),
        number_of(facts, "intercept_bleach_s"),
    )
