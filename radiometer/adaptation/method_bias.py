"""Mean difference between the threshold that a method finds and the eye's threshold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.adaptation.protocol import DownUpMethod, LimitsMethod, QuestPlusMethod, StaircaseMethod

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

    Exact for a usual psychometric function, averaged over the places of the levels; its uncertainty is that of the
    slope.
    """
    if isinstance(method, LimitsMethod):
        biases = [_ascent(slope, method.step_log10, method.start_below_log10) for slope in SLOPES]
    elif isinstance(method, DownUpMethod):
        biases = [_down_up(slope, method) for slope in SLOPES]
    else:
        return None
    return MethodBias(biases[1], (max(biases) - min(biases)) / math.sqrt(12.0))


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
