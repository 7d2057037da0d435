"""The uncertainty of a reading by the propagation of distributions, as a check on the linear budget."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np

from radiometer.analysis.reading.budget import PatchSituation, budget_terms, own_dark_u
from radiometer.data import Reading
from radiometer.typing import Array

# What the ends of an interval that was drawn are known to, in u: two and a half of their standard deviations.
_DRAWN_ENDS = 0.05


@dataclass(frozen=True, slots=True)
class Distribution:
    """What is known of a value after all inputs were drawn many times."""

    mean: float  # mean
    u: float  # standard deviation
    low: float  # lower end of the shortest interval that holds 95.45 %
    high: float  # its upper end

    def to_mapping(self, reading: Reading) -> dict[str, Any]:
        """Compare the distribution with a reading's interval: whether their ends agree to 5 % of u.

        Ends of a shortest interval from 100 000 draws scatter by some 2 % of u: less than 5 % shows no difference.
        The source allows at most half of u's second digit, which is between 0.5 % and 5 % of u.

        Source: JCGM 101:2008, section 8.1.
        """
        u, expanded = reading.radiance.u, reading.coverage_factor * reading.radiance.u
        tolerance = _DRAWN_ENDS * u
        low = self.low - (reading.radiance.value - expanded)
        high = self.high - (reading.radiance.value + expanded)
        return {
            "mean": self.mean,
            "u": self.u,
            "low": self.low,
            "high": self.high,
            "low_differs_by": low,
            "high_differs_by": high,
            "tolerance": tolerance,
            "validates": max(abs(low), abs(high)) <= tolerance,
        }


# Contributions that are drawn where they arise, in the signal; all others are factors of the value.
_IN_THE_SIGNAL = frozenset(
    {"repeatability", "pixel pattern", "source fluctuation", "response curve", "dark and black level", "stray light"}
)
# Factors that the measurement equation divides by.
_DIVISORS = frozenset({"exposure time", "exposure offset", "lens transmittance", "flat field", "fall-off"})


def propagate_distributions(situation: PatchSituation, rng: np.random.Generator, trials: int = 100_000) -> Distribution:
    """Return the distribution of a reading from draws of all its inputs through the measurement equation itself.

    The equation is L = s·Σ c_i·(x_i·(1 + curve_i) − d_i)·Π(1 + factor)/Π(1 + divisor)·(1 + stop)² + stray light:
    quotients and powers as they stand. Inputs from few observations are drawn from Student's t.

    Source: JCGM 101:2008, sections 5.9 to 7.7.
    """
    value = situation.scale * _rates(situation, rng, trials) - situation.stray
    size, stray = abs(situation.value) or 1.0, 0.0
    for term in budget_terms(situation):
        if term.u == 0.0 or term.name in _IN_THE_SIGNAL:
            stray = term.u if term.name == "stray light" else stray
            continue
        drawn = _student(term.u / size, term.degrees_of_freedom, rng, trials)
        if term.name == "f-number":
            value *= (1.0 + drawn / 2.0) ** 2
        elif term.name in _DIVISORS:
            value /= 1.0 + drawn
        else:
            value *= 1.0 + drawn
    return _summary(value + stray * rng.standard_normal(trials) if stray else value)


def _rates(situation: PatchSituation, rng: np.random.Generator, trials: int) -> Array:
    """Return drawn estimates: means of every frame with noise, pattern and fluctuation, through curve and dark."""
    estimate, count = situation.shown.estimate, int(situation.shown.good.sum())
    rates = np.zeros(trials)
    curve_counts = not situation.shares_level  # at the calibration's level its error drops out
    curve = rng.standard_normal(trials)  # one draw: the curve's error is taken as the same at all its numbers
    common_dark = rng.standard_normal(trials)
    of_exposure: defaultdict[tuple[float, float], Array] = defaultdict(lambda: rng.standard_normal(trials))
    for c, frame, dark, expected in zip(
        estimate.coefficients, situation.shown.frames, situation.shown.dark, estimate.expected, strict=True
    ):
        mean = float(frame.signal[situation.shown.good].mean())
        noise = np.sqrt((float(situation.model.variance(expected, frame.settings)) + dark.variance) / count)
        fluctuation = estimate.fluctuation_rel * expected
        drawn = mean + noise * rng.standard_normal(trials)
        drawn += _student(fluctuation, max(estimate.degrees_of_freedom, 1), rng, trials)
        bent = (drawn - dark.signal) * situation.model.curve_u_rel(expected, frame.settings) * curve * curve_counts
        own_dark = of_exposure[frame.settings.exposure_s, frame.settings.gain_db]
        dark_error = dark.u_common * common_dark + own_dark_u(estimate, dark, float(expected)) * own_dark
        rates += c * (drawn + bent - dark.signal - dark_error)
    pattern = next(term for term in budget_terms(situation) if term.name == "pixel pattern")
    return rates + _student(pattern.u / situation.scale, pattern.degrees_of_freedom, rng, trials)


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
