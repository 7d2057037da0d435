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
    """One effect (or unnamed term) as it was added.

    Attributes:
        name: Name of the effect, or `unnamed`.
        where: Covariate along which the disagreement lay.
        gain_nats: Improvement of the held-out log density.
        gap_before: Reduced χ² of held-out settings before.
        gap_after: The same after.
        rivals: Effects within 5 nats.
        closest: For an unnamed term, the closest entry and the share of it that it explains.
        block: For an unnamed term, the statistic that shows it.
        outperformed: Whether a plain trend of fewer parameters along the same covariate, or another entry, predicts
            better than the effect.
    """

    name: str
    where: str
    gain_nats: float
    gap_before: float
    gap_after: float
    rivals: tuple[CatalogueEffect, ...] = ()
    closest: tuple[str, float] | None = None
    block: str = ""
    outperformed: bool = False


@dataclass(frozen=True, eq=False)
class Search:
    """The outcome.

    Attributes:
        state: The fitted model.
        start: The ideal camera fitted.
        steps: What was added and stayed, in order.
        left: Disagreements that stay significant.
        tests: All tests of the final model.
        first_tests: All tests of the ideal camera.
        remarks: Further remarks on how it came about.
    """

    state: FitState
    start: FitState
    steps: tuple[Step, ...]
    left: tuple[Disagreement, ...]
    tests: tuple[Disagreement, ...]
    first_tests: tuple[Disagreement, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Reconciled:
    """A result with what it was drawn from, for the model file and the report.

    Attributes:
        result: The result.
        outcome: The search behind it.
        taken: Fits the starting camera to the frames as they were taken, where the search had them with light that
            comes back every so many of them taken out.
    """

    result: ReconcileResult
    outcome: Search
    taken: Callable[[], FitState] | None = None

    @property
    def start(self) -> FitState:
        """Return the starting camera fitted to the frames as they were taken."""
        return self.outcome.start if self.taken is None else self.taken()
