"""How well two visits agree: differences of break, S2, rod intercept and plateau, and their limits of agreement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.adaptation_fit import AdaptationFit

COMPARED: Final = ("break_min", "s2_slope_per_min", "rod_intercept_min", "plateau")
NORMAL_95: Final = 1.959964  # standard deviations on either side of the mean that hold 95 % of a normal distribution
FEWEST_PAIRS: Final = 3  # fewer differences have no limits worth the name


@dataclass(frozen=True, slots=True)
class Bound:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def to_mapping(self) -> dict[str, float]:
        """Return what is written to the JSON."""
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True, slots=True)
class Agreement:
    """Limits of agreement of one quantity."""

    mean: Bound  # mean of the differences, second less first visit
    sd: float  # their standard deviation
    lower: Bound  # lower limit of agreement: mean − 1.96·sd
    upper: Bound  # upper limit

    def to_mapping(self) -> dict[str, Any]:
        """Return what is written to the JSON."""
        limits = {name: getattr(self, name).to_mapping() for name in ("mean", "lower", "upper")}
        return {**limits, "sd": self.sd}


@dataclass(frozen=True, slots=True)
class Compared:
    """One quantity over all pairs of visits."""

    name: str  # its name
    unit: str  # its unit
    visits: NDArray[np.float64]  # first and second value of the pairs in which both visits have it, shape (pairs, 2)
    u: NDArray[np.float64]  # standard uncertainties of these by their fits; NaN where unknown
    missing: tuple[int, ...]  # numbers, from 1, of the pairs in which a visit has it not
    agreement: Agreement | None  # limits of agreement; None for fewer than three pairs

    @property
    def u_fits(self) -> float:
        """Return the standard uncertainty of a difference as the fits alone have it, root mean square of the pairs."""
        return math.sqrt(float(np.mean(np.sum(self.u**2, axis=1))))

    def to_mapping(self) -> dict[str, Any]:
        """Return what is written to the JSON."""
        return {
            "unit": self.unit,
            "pairs": len(self.visits),
            "visits": [[float(value) for value in pair] for pair in self.visits],
            "u_of_the_visits": [[float(u) if math.isfinite(u) else None for u in pair] for pair in self.u],
            "u_difference_of_the_fits": self.u_fits if math.isfinite(self.u_fits) else None,
            "pairs_without_it": list(self.missing),
            "agreement": None if self.agreement is None else self.agreement.to_mapping(),
        }


def limits_of_agreement(differences: NDArray[np.float64]) -> Agreement:
    """Return the limits of agreement of differences, each with its interval.

    Mean by Student's t; the limits are bounds of a normal distribution's quantiles μ ± 1.96 σ, whose estimate has a
    noncentral t distribution: exact for any number of pairs.

    Args:
        differences: Second less first visit, shape (pairs,), two at least.

    Raises:
        ValueError: If there are fewer than two.

    Source: Bland and Altman 1986 (Lancet 327, 307); intervals: Carkeet 2015 (Optom. Vis. Sci. 92, e71).
    """
    from scipy import stats

    count = differences.size
    if count < 2:
        raise ValueError("limits of agreement need two differences at least")
    mean, sd = float(differences.mean()), float(differences.std(ddof=1))
    tails, root = (0.025, 0.975), math.sqrt(count)  # 95 %
    reach = float(stats.t.ppf(tails[1], count - 1)) * sd / root
    near, far = (float(stats.nct.ppf(tail, count - 1, NORMAL_95 * root)) * sd / root for tail in tails)
    width = NORMAL_95 * sd
    return Agreement(
        Bound(mean, mean - reach, mean + reach),
        sd,
        Bound(mean - width, mean - far, mean - near),
        Bound(mean + width, mean + near, mean + far),
    )


def compare_visits(fits: Sequence[tuple[AdaptationFit, AdaptationFit]]) -> list[Compared]:
    """Return what two visits of each subject have in common, for every quantity that any pair has.

    Args:
        fits: Fits of first and second visit, one pair for each subject.
    """
    found = []
    for name in COMPARED:
        has = _has(fits, name)
        both = [(a.estimates[name], b.estimates[name]) for (a, b), known in zip(fits, has, strict=True) if known]
        if not both:
            continue
        visits = np.array([[a.value, b.value] for a, b in both])
        u = np.array([[a.u, b.u] for a, b in both])
        missing = tuple(number for number, known in enumerate(has, 1) if not known)
        enough = len(both) >= FEWEST_PAIRS
        agreement = limits_of_agreement(visits[:, 1] - visits[:, 0]) if enough else None
        found.append(Compared(name, both[0][0].unit, visits, u, missing, agreement))
    return found


def _has(fits: Sequence[tuple[AdaptationFit, AdaptationFit]], name: str) -> list[bool]:
    """Return which pairs have a quantity in both visits; a plateau without a break is not known to be the cones'."""
    return [all(name in fit.estimates and (fit.has_break or name != "plateau") for fit in pair) for pair in fits]
