"""The uncertainty of a reading by the propagation of distributions, as a check on the linear budget."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.patch.contributions import PatchSituation, local_scatter
from radiometer.analysis.patch.estimate import curve_u_rel
from radiometer.analysis.signal.situation import (
    f_number_u_rel,
    magnification_u_rel,
    spectral_u_rel,
    transmittance_u_rel,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Distribution:
    """What is known of a value after all inputs were drawn many times.

    Attributes:
        mean: Mean.
        u: Standard deviation.
        low: Lower end of the shortest interval that holds 95.45 %.
        high: Its upper end.
    """

    mean: float
    u: float
    low: float
    high: float


def propagate_distributions(situation: PatchSituation, rng: np.random.Generator, trials: int = 20_000) -> Distribution:
    """Return the distribution of a reading from draws of all its inputs through the measurement equation itself.

    The equation is L = s·Σ c_i·(x_i·(1 + curve_i) − d_i)·(1 + spectral) / [(1 + exposure)·(1 + f-number)⁻²·τ·flat],
    quotients and powers as they stand. Inputs from few observations are drawn from Student's t.

    Args:
        situation: What the reading was made from.
        rng: Source of the draws.
        trials: Number of draws.

    Source: JCGM 101:2008, sections 5.9 to 7.7.
    """
    rates = _rates(situation, rng, trials)
    calibration, stated = situation.calibration, situation.stated
    value = situation.scale * rates / (1.0 + stated.exposure_u_rel * rng.standard_normal(trials))
    if calibration is not None:
        value *= 1.0 + _drawn(calibration.scale.u_rel, calibration.scale.degrees_of_freedom, rng, trials)
        value *= 1.0 + spectral_u_rel(calibration, stated) * rng.standard_normal(trials)
        numbers = {frame.settings.f_number or situation.lens.f_number for frame in situation.frames}
        number_u = f_number_u_rel(calibration, stated, numbers)[0] / 2.0
        value *= (1.0 + number_u * rng.standard_normal(trials)) ** 2
        value /= 1.0 + transmittance_u_rel(calibration, situation.lens)[0] * rng.standard_normal(trials)
        value *= 1.0 + magnification_u_rel(calibration, situation.lens)[0] * rng.standard_normal(trials)
        flat_u = calibration.flat_field.u_rel if calibration.flat_field else 0.0
        value /= 1.0 + flat_u * rng.standard_normal(trials)
    return _summary(value)


def _rates(situation: PatchSituation, rng: np.random.Generator, trials: int) -> Array:
    """Return drawn estimates: means of every frame with noise, pattern and fluctuation, through curve and dark."""
    estimate, count = situation.estimate, int(situation.good.sum())
    rates = np.zeros(trials)
    curve = rng.standard_normal(trials)  # one draw: the curve's error is taken as the same at all its numbers
    common_dark = rng.standard_normal(trials)
    for c, frame, dark, expected in zip(
        estimate.coefficients, situation.frames, situation.dark, estimate.expected, strict=True
    ):
        mean = float(frame.signal[situation.good].mean())
        noise = np.sqrt(float(situation.model.variance(expected, frame.settings)) / count)
        fluctuation = estimate.fluctuation_rel * expected
        drawn = mean + noise * rng.standard_normal(trials)
        drawn += _student(fluctuation, max(estimate.degrees_of_freedom, 1), rng, trials)
        bent = (drawn - dark.signal) * curve_u_rel(situation.model, frame, expected) * curve
        lying = dark.u_common * common_dark + dark.u_independent * rng.standard_normal(trials)
        rates += c * (drawn + bent - dark.signal - lying)
    scatter, _ = local_scatter(estimate.pixel_rates, situation.good)
    beyond = max(0.0, scatter**2 - estimate.u_pixel**2) if count >= 16 else 0.0
    pattern: Array = np.sqrt(beyond / count) * rng.standard_normal(trials)
    return rates + pattern


def _drawn(u: float, degrees_of_freedom: float | None, rng: np.random.Generator, trials: int) -> Array:
    return _student(u, degrees_of_freedom or np.inf, rng, trials)


def _student(u: float, degrees_of_freedom: float, rng: np.random.Generator, trials: int) -> Array:
    """Return draws of scale u; of so few degrees of freedom that t has no variance, normal ones."""
    if u == 0.0:
        return np.zeros(trials)
    normal = degrees_of_freedom <= 2 or np.isinf(degrees_of_freedom)
    drawn: Array = rng.standard_normal(trials) if normal else rng.standard_t(degrees_of_freedom, trials)
    return u * drawn


def _summary(value: Array) -> Distribution:
    ordered = np.sort(value)
    inside = round(0.9545 * ordered.size)
    widths = ordered[inside:] - ordered[: ordered.size - inside]
    at = int(np.argmin(widths))
    return Distribution(float(value.mean()), float(value.std(ddof=1)), float(ordered[at]), float(ordered[at + inside]))
