"""Bright steps of the photon transfer, each less its dark signal; and groups that contradict the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.analysis.characterise.group_statistics import SAME_TEMPERATURE_K, GroupStatistics
from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.signal.rounding import unrounded_variance
from radiometer.data.sensor_noise import u_warmth_rel, warmer
from radiometer.errors import MeasurementError
from radiometer.statistics.scale import robust_sigma

SAME_EXPOSURE_REL = 1e-3  # cameras round exposures to microseconds; steps of a series differ by per cents
_NEIGHBOURS: Final = 2  # on either side
_FEWEST: Final = 6  # with fewer a local line through the neighbours hides a mistake
_LARGEST_PART: Final = 0.2  # of the groups: more are no exceptions
_OFF_SHARE: Final = 0.1  # of what its neighbours say
_OFF_SIGMAS: Final = 10.0  # far beyond chance: a mistake of the series, not its noise
_OFF_OF_TOP: Final = 0.01  # of the largest signal: less is offset
_AGREE_SHARE: Final = 1 / 3  # of its distance: how far the neighbours may lie from each other


@dataclass(frozen=True, slots=True)
class SignalStep:
    """One bright setting in one region, with its dark one."""

    bright: GroupStatistics  # statistics of the bright frames
    light: float  # what the signal is proportional to: photons per pixel where known, else exposure × source level in s
    dark_mean_dn: float  # mean of the dark signal at this exposure in DN
    u_dark_mean_dn: float  # its standard uncertainty
    dark_variance_dn2: float  # temporal variance of the dark signal in DN²
    u_dark_variance_dn2: float  # its standard uncertainty
    dark_noise_dn2: float = 0.0  # the same before rounding to whole codes
    u_dark_noise_dn2: float = 0.0  # its standard uncertainty; alike in all steps
    u_warmth_dn: float = 0.0  # standard uncertainty of that mean by temperatures: one error of all steps

    @property
    def signal_dn(self) -> float:
        """Return μ_y − μ_y.dark in DN."""
        return self.bright.mean_dn - self.dark_mean_dn

    @property
    def u_signal_dn(self) -> float:
        """Return the standard uncertainty of the signal due to noise in DN."""
        return math.hypot(self.bright.u_mean_dn, self.u_dark_mean_dn)

    @property
    def photo_variance_dn2(self) -> float:
        """Return σ_y² − σ_y.dark² in DN²."""
        return self.bright.variance_dn2 - self.dark_variance_dn2


def make_steps(
    bright: Sequence[GroupStatistics], dark: Sequence[GroupStatistics], step_dn: int = 1
) -> list[SignalStep]:
    """Return the bright groups with the dark signal of their exposure, by rising light.

    The dark group of the same exposure, gain and region is used; where there is none, a line through the others. Their
    temperature may differ by 1.5 K from that of the bright one: their dark current is scaled.

    Args:
        bright: Bright groups of one gain.

    Raises:
        MeasurementError: If a bright group has no matching dark group.
    """
    return sorted((_step(group, dark, step_dn) for group in bright), key=lambda step: (step.bright.region, step.light))


def _step(group: GroupStatistics, dark: Sequence[GroupStatistics], step_dn: int) -> SignalStep:
    fitting = [d for d in dark if d.region == group.region and d.has_noise and _same_temperature(d, group)]
    if not fitting:
        raise MeasurementError(
            "no dark frames at the gain and temperature of the bright ones: capture them with the shutter closed or "
            "the lens covered (radiometer bracket --darks 2)"
        )
    exposure, here_c = group.settings.exposure_s, group.settings.temperature_c
    light = group.photons if group.photons is not None else exposure * group.settings.source_level
    unexposed = _at_exposure(fitting, 0.0)
    fitting = [_as_warm(d, here_c, unexposed[0][0], unexposed[1][0]) for d in fitting]
    same = [d for d in fitting if math.isclose(d.settings.exposure_s, exposure, rel_tol=SAME_EXPOSURE_REL)]
    near = same[0] if same else min(fitting, key=lambda d: abs(d.settings.exposure_s - exposure))
    noise = unrounded_variance(near.variance_dn2, near.u_variance_dn2, near.mean_dn, near.spatial_variance_dn2, step_dn)
    if same:
        mean, variance = (near.mean_dn, near.u_mean_dn), (near.variance_dn2, near.u_variance_dn2)
    else:
        mean, variance = _at_exposure(fitting, exposure)
    u_rel = u_warmth_rel(here_c, [d.settings.temperature_c for d in fitting])
    u_warmth = u_rel * max(mean[0] - unexposed[0][0], 0.0)
    return SignalStep(group, light, *mean, *variance, noise.value, noise.u, u_warmth)


def _at_exposure(dark: Sequence[GroupStatistics], exposure_s: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return (value, uncertainty) of mean in DN and of variance in DN² at an exposure, of lines over dark groups."""
    mean = _from_line(dark, exposure_s, [(d.mean_dn, d.u_mean_dn) for d in dark])
    return mean, _from_line(dark, exposure_s, [(d.variance_dn2, d.u_variance_dn2) for d in dark])


def _as_warm(dark: GroupStatistics, here_c: float | None, mean_dn: float, variance_dn2: float) -> GroupStatistics:
    """Return a dark group as at another temperature, by its mean and variance at exposure 0."""
    factor = warmer(here_c, dark.settings.temperature_c)
    mean, variance = (
        mean_dn + factor * (dark.mean_dn - mean_dn),
        variance_dn2 + factor * (dark.variance_dn2 - variance_dn2),
    )
    return replace(dark, mean_dn=mean, variance_dn2=max(variance, 0.0))


def _from_line(
    dark: Sequence[GroupStatistics], exposure_s: float, values: Sequence[tuple[float, float]]
) -> tuple[float, float]:
    """Return value and uncertainty at an exposure from a line over the dark groups (their mean where only one)."""
    times = np.array([d.settings.exposure_s for d in dark])
    y, u = np.array(values).T
    u = np.maximum(u, 1e-9)
    if np.unique(times).size < 2:
        return float(y.mean()), float(np.sqrt(np.mean(u**2) / u.size))
    centre = float(np.average(times, weights=u**-2))
    line = fit_line(times - centre, y, u)
    distance = exposure_s - centre
    return line.slope * distance + line.intercept, math.hypot(line.u_slope * distance, line.u_intercept)


def _same_temperature(one: GroupStatistics, other: GroupStatistics) -> bool:
    a, b = one.settings.temperature_c, other.settings.temperature_c
    return a is None or b is None or abs(a - b) <= SAME_TEMPERATURE_K


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
        near = _neighbours(index, len(ordered))
        if not near:
            continue
        expected = float(np.median(ratios[near])) * step.light
        off = abs(step.signal_dn - expected)
        agree = float(np.median(np.abs(ratios[near] * step.light - expected))) < _AGREE_SHARE * off
        if agree and off > max(_OFF_SHARE * abs(expected), _OFF_SIGMAS * step.u_signal_dn, _OFF_OF_TOP * top):
            found.append((step, _in_words(step.bright, step.signal_dn, expected)))
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
            found.append((group, _in_words(group, group.mean_dn, expected)))
    return found if len(found) <= max(1, int(_LARGEST_PART * len(dark))) else []


def _median_slope(x: np.ndarray, y: np.ndarray) -> float:
    i, j = np.triu_indices(x.size, 1)
    apart = x[i] != x[j]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart])) if apart.any() else 0.0


def _neighbours(index: int, count: int) -> list[int]:
    """Return as many neighbours below as above; none at the ends, where saturation and a mistake look alike."""
    reach = min(_NEIGHBOURS, index, count - 1 - index)
    return [*range(index - reach, index), *range(index + 1, index + reach + 1)]


def _in_words(group: GroupStatistics, found_dn: float, expected_dn: float) -> str:
    light = "" if group.photons is None else f" and {group.photons:g} photons"
    kind = "dark" if group.settings.is_dark else "bright"
    share = 100.0 * (found_dn / expected_dn - 1.0) if expected_dn else math.inf
    return (
        f"left out: the {kind} group of {group.frames} frames at {group.settings.exposure_s:g} s{light} shows "
        f"{found_dn:.4g} DN where all others say {expected_dn:.4g} ({share:+.0f} %)"
    )
