"""The GUM uncertainty budget of a value: contributions, their combination, and the degrees of freedom behind it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from scipy import special

from radiometer.data import Contribution, Flag, Quantity, Reading
from radiometer.errors import MeasurementError

_DEPENDS_ON_LEVEL: Final = frozenset({"response curve"})
_SAME_LEVEL_REL: Final = 0.1


@dataclass(frozen=True, slots=True)
class Term:
    """One contribution in the unit of the value.

    Attributes:
        name: What the uncertainty comes from.
        u: Standard uncertainty of the value due to it, in the value's unit, 0 or more.
        kind: "A" (from repeated observation) or "B" (from anything else).
        degrees_of_freedom: Of the estimate; infinite where taken as exactly known.
        correlated: True where two readings made with one calibration share it.
        note: Where the figure comes from.
        flag: Raised where the contribution dominates a reading; None for one that needs no separate word.
    """

    name: str
    u: float
    kind: str = "B"
    degrees_of_freedom: float = math.inf
    correlated: bool = False
    note: str = ""
    flag: Flag | None = None

    def contribution(self, value: float) -> Contribution:
        """Return the line of the budget relative to a value (relative to its own u where the value is zero)."""
        reference = abs(value) or self.u or 1.0
        return Contribution(
            self.name, self.u / reference, self.kind, self.degrees_of_freedom, self.correlated, self.note
        )


def combined_u(terms: Iterable[Term]) -> float:
    """Return the combined standard uncertainty of independent contributions.

    Source: JCGM 100:2008, equation (10).
    """
    return math.sqrt(sum(term.u**2 for term in terms))


def effective_degrees_of_freedom(terms: Iterable[Term]) -> float:
    """Return the effective degrees of freedom of the combined uncertainty; infinite where all are.

    Source: JCGM 100:2008, equation (G.2b), Welch and Satterthwaite.
    """
    listed = list(terms)
    spread = sum(term.u**4 / term.degrees_of_freedom for term in listed)
    return math.inf if spread == 0.0 else combined_u(listed) ** 4 / spread


def coverage_factor(degrees_of_freedom: float, probability: float = 0.9545) -> float:
    """Return the factor k that makes an interval hold the value with a probability (0.9545 is k = 2 for normal).

    Args:
        degrees_of_freedom: Effective degrees of freedom, above 0; may be infinite.
        probability: Coverage probability, above 0 and below 1.

    Source: JCGM 100:2008, annex G.
    """
    return float(special.stdtrit(min(degrees_of_freedom, 1e9), 0.5 + probability / 2.0))


def shares(contributions: Iterable[Contribution]) -> list[tuple[Contribution, float]]:
    """Return contributions with their share of the variance (they sum to 1), the largest first."""
    listed = sorted(contributions, key=lambda one: -one.u_rel)
    total = sum(one.u_rel**2 for one in listed)
    return [(one, one.u_rel**2 / total if total else 0.0) for one in listed]


def covariance(first: Reading, second: Reading) -> float:
    """Return the covariance of two readings made with one calibration, in the square of their unit.

    What the calibration brings in (scale, flat field, …) shifts both alike; all else is independent. The response
    curve's error is shared only by readings of nearly the same radiance: elsewhere other parts of the curve serve.

    Args:
        first: A reading.
        second: Another reading made with the same calibration.

    Source: JCGM 100:2008, section F.1.2.3.
    """
    of_second = {one.name: one.u_rel for one in second.budget if one.correlated}
    a, b = first.radiance.value, second.radiance.value
    level_differs = abs(a - b) > _SAME_LEVEL_REL * max(abs(a), abs(b))
    shared = sum(
        one.u_rel * of_second.get(one.name, 0.0)
        for one in first.budget
        if one.correlated and not (level_differs and one.name in _DEPENDS_ON_LEVEL)
    )
    return shared * abs(a) * abs(b)


def ratio(first: Reading, second: Reading) -> Quantity:
    """Return first/second: what the calibration shares drops out of its uncertainty.

    Raises:
        MeasurementError: If the second reading is 0.
    """
    a, b = first.radiance, second.radiance
    if b.value == 0.0:
        raise MeasurementError("a ratio to a reading of 0 has no value")
    value = a.value / b.value
    variance = (
        (a.u / b.value) ** 2 + (value * b.u / b.value) ** 2 - 2.0 * value * covariance(first, second) / b.value**2
    )
    return Quantity(value, math.sqrt(max(variance, 0.0)), "1")


def difference(first: Reading, second: Reading) -> Quantity:
    """Return first − second, the shared part of the calibration taken into account."""
    variance = first.radiance.u**2 + second.radiance.u**2 - 2.0 * covariance(first, second)
    return Quantity(first.radiance.value - second.radiance.value, math.sqrt(max(variance, 0.0)), first.radiance.unit)


def mean(readings: Sequence[Reading]) -> Quantity:
    """Return the mean of readings made with one calibration: what they share does not average out.

    Raises:
        MeasurementError: If there is none.
    """
    if not readings:
        raise MeasurementError("the mean of no readings has no value")
    values = [one.radiance.value for one in readings]
    variance = sum(one.radiance.u**2 for one in readings)
    variance += 2.0 * sum(covariance(a, b) for i, a in enumerate(readings) for b in readings[:i])
    return Quantity(sum(values) / len(values), math.sqrt(max(variance, 0.0)) / len(values), readings[0].radiance.unit)
