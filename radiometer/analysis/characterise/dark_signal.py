"""Dark frames: black level, temporal dark noise, dark current and how it doubles with temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.line_fit import Line, fit_line
from radiometer.analysis.characterise.rounding import PLAIN_FROM
from radiometer.data import Quantity

_SAME_TEMPERATURE_K = 1.5


@dataclass(frozen=True, slots=True)
class DarkSignal:
    """The dark signal of one temperature.

    Attributes:
        mean_line: Mean in DN over exposure in s; None where all darks have one exposure.
        variance_line: Temporal variance in DN² over exposure in s; None where all darks have one exposure.
        mean_dn: Mean at exposure 0 with standard uncertainty in DN.
        variance_dn2: Temporal variance at exposure 0 in DN²; where rounding hides the noise, the most that it can be.
        temperature_c: Mean sensor temperature; None where unknown.
        quantisation_limited: The variance is below 0.24 DN², where rounding hides the noise.
    """

    mean_line: Line | None
    variance_line: Line | None
    mean_dn: Quantity
    variance_dn2: Quantity
    temperature_c: float | None
    quantisation_limited: bool


def dark_signal(dark: Sequence[GroupStatistics], step_dn: int = 1) -> DarkSignal:
    """Return the dark signal of groups of one gain, region and temperature.

    Groups of one frame determine its mean only.

    Args:
        dark: The groups; at least one of them with two frames or more.
        step_dn: Distance between codes in DN.

    Source: EMVA Standard 1288, release 4.0, sections 6.7 and 7.
    """
    times = np.array([d.settings.exposure_s for d in dark])
    common = pooled_frame_sd(dark)
    means = np.array([d.mean_dn for d in dark])
    u_means = np.array([max(d.u_mean_dn, common / math.sqrt(d.frames)) for d in dark])
    mean_line = None
    if np.unique(times).size > 2:
        mean_line = fit_line(times, means, u_means)
        mean = Quantity(mean_line.intercept, mean_line.u_intercept, "DN")
    else:
        first = int(np.argmin(times))
        mean = Quantity(float(means[first]), float(u_means[first]), "DN")
    variance_line, variance = _variance([d for d in dark if d.has_noise])
    smallest = PLAIN_FROM * step_dn**2
    limited = variance.value < smallest
    if limited:  # all that is known is a bound; over [0, bound] the root mean square distance from it is bound/√3
        variance = Quantity(smallest, smallest / math.sqrt(3.0), "DN^2")
    known = [d.settings.temperature_c for d in dark if d.settings.temperature_c is not None]
    return DarkSignal(
        mean_line,
        variance_line,
        mean,
        variance,
        float(np.mean(known)) if known else None,
        limited,
    )


def hidden_noise(step_dn: int = 1) -> str:
    """Return in words that rounding hides the temporal noise of dark frames.

    Args:
        step_dn: Distance between codes in DN.
    """
    return (
        f"the dark noise is below {PLAIN_FROM * step_dn**2:g} DN², where rounding hides it: sigma_y_dark is "
        "the most that it can be; raise the gain to measure it"
    )


def _variance(dark: Sequence[GroupStatistics]) -> tuple[Line | None, Quantity]:
    """Return the line of the variance over exposure where there are three, and the variance at exposure 0 in DN²."""
    times = np.array([d.settings.exposure_s for d in dark])
    variances, u = np.array([(d.variance_dn2, max(d.u_variance_dn2, 1e-9)) for d in dark]).T
    if np.unique(times).size > 2:
        line = fit_line(times, variances, u)
        return line, Quantity(line.intercept, line.u_intercept, "DN^2")
    first = int(np.argmin(times))
    return None, Quantity(float(variances[first]), float(u[first]), "DN^2")


def by_temperature(dark: Sequence[GroupStatistics]) -> list[list[GroupStatistics]]:
    """Return the dark groups by plateau of temperature (gaps above 1.5 K part them), the coldest first."""
    ordered = sorted(dark, key=lambda d: -273.0 if d.settings.temperature_c is None else d.settings.temperature_c)
    plateaus: list[list[GroupStatistics]] = []
    for group in ordered:
        here = group.settings.temperature_c
        before = plateaus[-1][-1].settings.temperature_c if plateaus else None
        if plateaus and (here is None or before is None or here - before <= _SAME_TEMPERATURE_K):
            plateaus[-1].append(group)
        else:
            plateaus.append([group])
    return plateaus


def pooled_frame_sd(dark: Sequence[GroupStatistics]) -> float:
    """Return the standard deviation in DN by which frames of one setting differ in their mean; 0 where none repeats.

    Black levels wander from frame to frame by more than the noise of so many pixels leaves in a mean.
    """
    repeated = [d for d in dark if d.frames > 1]
    freedom = sum(d.frames - 1 for d in repeated)
    return math.sqrt(sum((d.frames - 1) * d.frame_variance_dn2 for d in repeated) / freedom) if freedom else 0.0


def doubling_temperature(
    rates: Sequence[tuple[float, Quantity]], u_temperatures_k: Sequence[float] | None = None
) -> Quantity | None:
    """Return the temperature step in K that doubles the dark current, from ln D over T.

    Args:
        rates: (temperature in °C, dark current) per plateau.
        u_temperatures_k: Standard uncertainty of each temperature in K; 0 where None.

    Returns:
        None where fewer than two plateaus have a dark current above twice its uncertainty, or it does not rise.

    Source: EMVA Standard 1288, release 4.0, equation (17).
    """
    spread = u_temperatures_k or [0.0] * len(rates)
    usable = [(t, q, u) for (t, q), u in zip(rates, spread, strict=True) if q.value > 2 * q.u]
    if len(usable) < 2:
        return None
    temperatures = np.array([t for t, _, _ in usable])
    logs = [math.log(q.value) for _, q, _ in usable]
    slope = 0.0
    for _ in range(2):
        u = [max(math.hypot(q.u_rel, slope * u_t), 1e-9) for _, q, u_t in usable]
        line = fit_line(temperatures - temperatures.mean(), logs, u)
        slope = line.slope
    if line.slope <= 0:
        return None
    return Quantity(math.log(2) / line.slope, math.log(2) / line.slope**2 * line.u_slope, "K")
