"""Groups of frames that contradict all others: named and left out, instead of averaged into every figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.statistics.scale import robust_sigma

_NEIGHBOURS: Final = 2  # on either side
_FEWEST: Final = 6
_LARGEST_PART: Final = 0.2  # of the groups: more are no exceptions
_OFF_SHARE: Final = 0.1  # of what its neighbours say
_OFF_SIGMAS: Final = 10.0
_OFF_OF_TOP: Final = 0.01  # of the largest signal: less is offset
_AGREE_SHARE: Final = 1 / 3  # of its distance: how far the neighbours may lie from each other


def contradicting_steps(steps: Sequence[SignalStep]) -> list[tuple[SignalStep, str]]:
    """Return bright steps whose signal over light is far off that of their neighbours in light, with a line each.

    A step is off where its signal differs by more than 10 %, ten of its standard uncertainties and 1 % of the largest
    signal from its neighbours. These are the steps below and above in light, and must agree with each other.

    Args:
        steps: Bright steps of one region, any order.
    """
    ordered = sorted((s for s in steps if s.light > 0), key=lambda s: s.light)
    if len(ordered) < _FEWEST:
        return []
    top = max(s.signal_dn for s in ordered)
    ratios = np.array([s.signal_dn / s.light for s in ordered])
    found = []
    for index, step in enumerate(ordered):
        near = _beside(index, len(ordered))
        if not near:
            continue
        expected = float(np.median(ratios[near])) * step.light
        off = abs(step.signal_dn - expected)
        agree = float(np.median(np.abs(ratios[near] * step.light - expected))) < _AGREE_SHARE * off
        if agree and off > max(_OFF_SHARE * abs(expected), _OFF_SIGMAS * step.u_signal_dn, _OFF_OF_TOP * top):
            found.append((step, _said(step.bright, step.signal_dn, expected)))
    return found if len(found) <= max(1, int(_LARGEST_PART * len(ordered))) else []


def contradicting_darks(dark: Sequence[GroupStatistics], top_dn: float) -> list[tuple[GroupStatistics, str]]:
    """Return dark groups far off the line of the others over exposure, with a line each.

    Args:
        dark: Dark groups of one region and temperature.
        top_dn: Largest bright signal in DN; 0 where there is none.
    """
    if len(dark) < _FEWEST:
        return []
    times = np.array([d.settings.exposure_s for d in dark])
    means = np.array([d.mean_dn for d in dark])
    slope = _median_slope(times, means)
    rest = means - slope * times
    centre = float(np.median(rest))
    spread = robust_sigma(rest)
    found = []
    for index, group in enumerate(dark):
        off = abs(float(rest[index]) - centre)
        expected = centre + slope * float(times[index])
        far = max(_OFF_SIGMAS * max(spread, group.u_mean_dn), _OFF_OF_TOP * top_dn, _OFF_SHARE * abs(expected))
        if off > far:
            found.append((group, _said(group, group.mean_dn, expected)))
    return found if len(found) <= max(1, int(_LARGEST_PART * len(dark))) else []


def _median_slope(x: np.ndarray, y: np.ndarray) -> float:
    i, j = np.triu_indices(x.size, 1)
    apart = x[i] != x[j]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart])) if apart.any() else 0.0


def _beside(index: int, count: int) -> list[int]:
    """Return as many neighbours below as above; none at the ends, where saturation and a mistake look alike."""
    reach = min(_NEIGHBOURS, index, count - 1 - index)
    return [*range(index - reach, index), *range(index + 1, index + reach + 1)]


def _said(group: GroupStatistics, found_dn: float, expected_dn: float) -> str:
    light = "" if group.photons is None else f" and {group.photons:g} photons"
    kind = "dark" if group.settings.is_dark else "bright"
    share = 100.0 * (found_dn / expected_dn - 1.0) if expected_dn else math.inf
    return (
        f"left out: the {kind} group of {group.frames} frames at {group.settings.exposure_s:g} s{light} shows "
        f"{found_dn:.4g} DN where all others say {expected_dn:.4g} ({share:+.0f} %)"
    )
