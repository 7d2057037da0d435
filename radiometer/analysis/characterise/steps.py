"""Bright steps of the photon transfer, each with the dark signal of its exposure taken off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.characterise.rounding import unrounded_variance
from radiometer.errors import MeasurementError

_SAME_EXPOSURE_REL = 1e-3
_SAME_TEMPERATURE_K = 1.5


@dataclass(frozen=True, slots=True)
class SignalStep:
    """One bright setting in one region, with its dark one.

    Attributes:
        bright: Statistics of the bright frames.
        light: What the signal is proportional to: photons per pixel where known, else exposure × source level in s.
        dark_mean_dn: Mean of the dark signal at this exposure in DN.
        u_dark_mean_dn: Its standard uncertainty.
        dark_variance_dn2: Temporal variance of the dark signal in DN².
        u_dark_variance_dn2: Its standard uncertainty.
        dark_noise_dn2: The same before rounding to whole codes.
        u_dark_noise_dn2: Its standard uncertainty; alike in all steps.
    """

    bright: GroupStatistics
    light: float
    dark_mean_dn: float
    u_dark_mean_dn: float
    dark_variance_dn2: float
    u_dark_variance_dn2: float
    dark_noise_dn2: float = 0.0
    u_dark_noise_dn2: float = 0.0

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

    The dark group of the same exposure, gain, region and temperature is used; where there is none, a line through
    the others.

    Args:
        bright: Bright groups of one gain.
        dark: Dark groups of that gain.
        step_dn: Distance between codes in DN.

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
    exposure = group.settings.exposure_s
    level = group.settings.source_level
    light = group.photons if group.photons is not None else exposure * level
    same = [d for d in fitting if math.isclose(d.settings.exposure_s, exposure, rel_tol=_SAME_EXPOSURE_REL)]
    near = same[0] if same else min(fitting, key=lambda d: abs(d.settings.exposure_s - exposure))
    noise = unrounded_variance(near.variance_dn2, near.u_variance_dn2, near.mean_dn, near.spatial_variance_dn2, step_dn)
    if same:
        mean, variance = (near.mean_dn, near.u_mean_dn), (near.variance_dn2, near.u_variance_dn2)
    else:
        mean = _from_line(fitting, exposure, [(d.mean_dn, d.u_mean_dn) for d in fitting])
        variance = _from_line(fitting, exposure, [(d.variance_dn2, d.u_variance_dn2) for d in fitting])
    return SignalStep(group, light, *mean, *variance, noise.value, noise.u)


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
    return a is None or b is None or abs(a - b) <= _SAME_TEMPERATURE_K
