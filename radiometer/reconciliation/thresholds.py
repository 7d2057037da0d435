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
_ODDS: Final = "a statement about odds, not a measurement"


def _acted(sessions: int) -> str:
    return f"acted in {sessions} of 79 sessions (docs/benchmarks/reconcile.md, rules that decide a name)"


SIGNIFICANCE: Final = _row(
    "SIGNIFICANCE",
    0.005,
    "chance",
    "a false alarm among all tests of one pass, and among the few in a name's own place",
    _NULL,
)
FRAME_SIGNIFICANCE: Final = _row(
    "FRAME_SIGNIFICANCE",
    0.001,
    "chance",
    "a period among frames that scatter at random, one of equal frames reported as an outlier by chance",
    "40 lamps that wander by 2 % (tests/unit/reconciliation/test_frame_order.py), series drawn at random "
    "(tests/unit/reconciliation/test_reconcile_places.py): none; at 0.005 the plan that settles a first answer found "
    "a further name (tests/system/test_reconcile_chain.py)",
)
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
    _ODDS,
)
SMOOTH_SHARE: Final = _row(
    "SMOOTH_SHARE", 0.8, "1", "a name that explains less than a curve without meaning along the covariate", _acted(16)
)

# What a name must bring, less what a parameter costs. Rivals are within it; a flexible form that takes a name from a
# rigid entry of another leads by as much.
RIVAL_NATS: Final = NAMED_NATS - PARAMETER_NATS

ESSENTIAL_SIGMAS: Final = _row(
    "ESSENTIAL_SIGMAS",
    3.0,
    "sigma",
    "an entry that neither its own statistic nor its essential parameter shows, only others that it happens to improve",
    _acted(20),
)

TABLE: Final[tuple[Threshold, ...]] = tuple(_ROWS.values())


def is_open(gap: float, count: float) -> bool:
    """Return whether the reduced χ² of so many held-out entries exceeds 1 by more than chance."""
    return gap > max(CLOSED_GAP, 1.0 + SCATTER_SIGMAS * math.sqrt(2.0 / max(count, 1.0)))
