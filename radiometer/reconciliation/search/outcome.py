"""Holds the outcome of a search: its steps, the final model, and the result drawn from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.result import ReconcileResult
from radiometer.reconciliation.search.localise import Disagreement
from simulators.effects.catalogue import CatalogueEffect


@dataclass(frozen=True, slots=True)
class Step:
    """One effect (or unnamed term) as it was added."""

    name: str  # name of the effect, or `unnamed`
    where: str  # covariate along which the disagreement lay
    gain_nats: float  # improvement of the held-out log density
    gap_before: float  # reduced χ² of held-out settings before
    gap_after: float  # the same after
    rivals: tuple[CatalogueEffect, ...] = ()  # effects within 5 nats
    # For an unnamed term, the closest entry and the share of it that it explains
    closest: tuple[str, float] | None = None
    block: str = ""  # for an unnamed term, the statistic that shows it
    # Whether a plain trend of fewer parameters along the same covariate, or another entry, predicts better than the
    # effect
    outperformed: bool = False


@dataclass(frozen=True, eq=False)
class Search:
    """The outcome."""

    state: FitState  # the fitted model
    start: FitState  # the ideal camera fitted
    steps: tuple[Step, ...]  # what was added and stayed, in order
    left: tuple[Disagreement, ...]  # disagreements that stay significant
    tests: tuple[Disagreement, ...]  # all tests of the final model
    first_tests: tuple[Disagreement, ...]  # all tests of the ideal camera
    remarks: tuple[str, ...] = ()  # further remarks on how it came about


@dataclass(frozen=True, eq=False)
class Reconciled:
    """A result with what it was drawn from, for the model file and the report."""

    result: ReconcileResult  # the result
    outcome: Search  # the search behind it
    # Fits the starting camera to the frames as they were taken, where the search had them with light that comes back
    # every so many of them taken out
    taken: Callable[[], FitState] | None = None

    @property
    def start(self) -> FitState:
        """Return the starting camera fitted to the frames as they were taken."""
        return self.outcome.start if self.taken is None else self.taken()
