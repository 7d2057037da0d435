"""Dark frames: black level, temporal dark noise, dark current and how it doubles with temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.line_fit import Line, fit_line
from radiometer.analysis.characterise.photon_transfer import SMALLEST_VARIANCE_DN2
from radiometer.data import Quantity

_SAME_TEMPERATURE_K = 1.5


@dataclass(frozen=True, slots=True)
class DarkSignal:
    """The dark signal of one temperature.

    Attributes:
        mean_line: Mean in DN over exposure in s; None where all darks have one exposure.
        variance_line: Temporal variance in DN² over exposure in s; None where all darks have one exposure.
        mean_dn: Mean at exposure 0 with standard uncertainty in DN.
        variance_dn2: Temporal variance at exposure 0 in DN².
        temperature_c: Mean sensor temperature; None where unknown.
        quantisation_limited: The variance is below 0.24 DN², where rounding hides the noise.
    """

    mean_line: Line | None
    variance_line: Line | None
    mean_dn: Quantity
    variance_dn2: Quantity
    temperature_c: float | None
    quantisation_limited: bool


def dark_signal(dark: Sequence[GroupStatistics]) -> DarkSignal:
    """Return the dark signal of groups of one gain, region and temperature.

    Source: EMVA Standard 1288, release 4.0, sections 6.7 and 7.
    """
    times = np.array([d.settings.exposure_s for d in dark])
    means, u_means = np.array([(d.mean_dn, d.u_mean_dn) for d in dark]).T
    variances, u_variances = np.array([(d.variance_dn2, d.u_variance_dn2) for d in dark]).T
    mean_line = variance_line = None
    if np.unique(times).size > 2:
        mean_line = fit_line(times, means, u_means)
        variance_line = fit_line(times, variances, np.maximum(u_variances, 1e-9))
        mean = Quantity(mean_line.intercept, mean_line.u_intercept, "DN")
        variance = Quantity(variance_line.intercept, variance_line.u_intercept, "DN^2")
    else:
        first = int(np.argmin(times))
        mean = Quantity(float(means[first]), float(u_means[first]), "DN")
        variance = Quantity(float(variances[first]), float(u_variances[first]), "DN^2")
    limited = variance.value < SMALLEST_VARIANCE_DN2
    floor = max(variance.value, SMALLEST_VARIANCE_DN2)
    known = [d.settings.temperature_c for d in dark if d.settings.temperature_c is not None]
    return DarkSignal(
        mean_line,
        variance_line,
        mean,
        Quantity(floor, variance.u, "DN^2"),
        float(np.mean(known)) if known else None,
        limited,
    )


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


def doubling_temperature(rates: Sequence[tuple[float, Quantity]]) -> Quantity | None:
    """Return the temperature step in K that doubles the dark current, from ln D over T.

    Args:
        rates: (temperature in °C, dark current) per plateau.

    Returns:
        None where fewer than two plateaus have a dark current above twice its uncertainty, or it does not rise.

    Source: EMVA Standard 1288, release 4.0, equation (17).
    """
    usable = [(t, q) for t, q in rates if q.value > 2 * q.u]
    if len(usable) < 2:
        return None
    temperatures = np.array([t for t, _ in usable])
    line = fit_line(
        temperatures - temperatures.mean(),
        [math.log(q.value) for _, q in usable],
        [max(q.u_rel, 1e-9) for _, q in usable],
    )
    if line.slope <= 0:
        return None
    return Quantity(math.log(2) / line.slope, math.log(2) / line.slope**2 * line.u_slope, "K")
