"""Every threshold of the search and of the verdict, in one table: name, value, what it protects from, what measured it.

What counts numerics (batch sizes, steps of differences, iterations) stands where it is used; what decides about a name
stands here and nowhere else. A nat is a factor of e in likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

_TOGETHER: Final = (
    "set in development; its effect alone was not measured, the benchmark holds for all thresholds together"
)


@dataclass(frozen=True, slots=True)
class Threshold:
    """One row of the table."""

    name: str  # name of the constant
    value: float  # its value
    unit: str  # nats, chance, χ², sigma, 1
    reason: str  # what it protects from
    measured: str = _TOGETHER  # what measured it, or that nothing did


_ROWS: dict[str, Threshold] = {}


def _row(name: str, value: float, unit: str, reason: str, measured: str = _TOGETHER) -> float:
    _ROWS[name] = Threshold(name, value, unit, reason, measured)
    return value


_NULL: Final = "sets without an effect (docs/benchmarks/reconcile.md): share of false alarms and largest gap"

SIGNIFICANCE: Final = _row(
    "SIGNIFICANCE",
    0.005,
    "chance",
    "a false alarm among all tests of one pass, and among the few in a name's own place",
    _NULL,
)
# Of each of the three questions that single frames answer (Bonferroni): does light come back in their order, and does
# one of the dark frames, or one of the lit ones, differ from its equals?
FRAME_SIGNIFICANCE: Final = SIGNIFICANCE / 3.0
SCATTER_SIGMAS: Final = _row(
    "SCATTER_SIGMAS", 5.0, "sigma", "scatter without any trend, which no test along a covariate sees", _NULL
)
CLOSED_GAP: Final = _row(
    "CLOSED_GAP", 1.05, "1", "calling a gap open that is chance; it was 1.02 at most in 365 sets", _NULL
)

PARAMETER_NATS: Final = _row(
    "PARAMETER_NATS",
    3.0,
    "nats",
    "freedom that is no knowledge: each parameter pays it beyond what held-out settings say; names that bring less "
    "next to later ones",
)
NAMED_NATS: Final = _row(
    "NAMED_NATS",
    8.0,
    "nats",
    "a name, another law or another name in its place by chance: odds of 3000, and ln(starts) more, as one of many "
    "starts fits by chance; also what a curve may predict better by",
    "a statement about odds, not a measurement",
)
SMOOTH_SHARE: Final = _row(
    "SMOOTH_SHARE",
    0.8,
    "1",
    "a name that explains less than a curve without meaning along the covariate",
    "acted in 16 of 79 sessions (docs/benchmarks/reconcile.md, rules that decide a name)",
)

# What a name must bring, less what a parameter costs. Rivals are within it; a flexible form that takes a name from a
# rigid entry of another leads by as much. So much its own statistic must bring too, else other statistics that it
# happens to improve name it.
RIVAL_NATS: Final = NAMED_NATS - PARAMETER_NATS
# An essential parameter so many standard uncertainties from nothing brings as much: 3.2.
ESSENTIAL_SIGMAS: Final = math.sqrt(2.0 * RIVAL_NATS)

TABLE: Final[tuple[Threshold, ...]] = tuple(_ROWS.values())


def is_open(gap: float, count: float) -> bool:
    """Return whether the reduced χ² of so many held-out entries exceeds 1 by more than chance."""
    return gap > max(CLOSED_GAP, 1.0 + SCATTER_SIGMAS * math.sqrt(2.0 / max(count, 1.0)))
