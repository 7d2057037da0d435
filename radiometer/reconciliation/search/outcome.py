"""Holds the outcome of a search, and the one score by which its models are compared.

The score is the held-out log density plus the log prior odds of the names, each parameter paid for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.reconciliation.fit.candidate_fit import FittedCandidate
from radiometer.reconciliation.fit.descent import FullFits
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.result import ReconcileResult
from radiometer.reconciliation.search.localise import Disagreement
from radiometer.reconciliation.thresholds import (
    ESSENTIAL_SIGMAS,
    HUGE_NATS,
    NAMED_NATS,
    PARAMETER_NATS,
    RIVAL_NATS,
)
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


# ---- scores ---------------------------------------------------------------------------------------------------------


Judged = tuple[FittedCandidate, float]


def worth(state: FitState) -> float:
    """Return the score of a model: its held-out log density, each parameter and each column of a curve paid for."""
    return state.evidence - PARAMETER_NATS * (state.parameters.size + state.curves)


def rated(state: FitState) -> float:
    """Return the score of a model with the prior odds of its names."""
    return worth(state) + sum(effect.log_prior_odds for effect in state.effects)


def penalised_chi2(fitted: FittedCandidate) -> float:
    """Return the χ² that a candidate explains, less what it pays for its parameters and for being unlikely."""
    return fitted.gain - 2.0 * _penalty(fitted)


def _penalty(fitted: FittedCandidate) -> float:
    return PARAMETER_NATS * fitted.parameters - fitted.effect.log_prior_odds


def score(entry: tuple[FittedCandidate, float]) -> float:
    """Return the nats of a judged candidate less what it pays."""
    fitted, nats = entry
    return nats - _penalty(fitted) - (RIVAL_NATS if fitted.flexible else 0.0)


def is_shown(fitted: FittedCandidate, nats: float) -> bool:
    """Return whether settings held out are predicted better, and in the statistic that must show it too.

    Of many starts one fits by chance.
    """
    needed = NAMED_NATS - fitted.effect.log_prior_odds + float(np.log(fitted.tries))
    needed += RIVAL_NATS if fitted.flexible else 0.0
    return nats >= needed and fitted.evidence >= ESSENTIAL_SIGMAS**2


def contenders_of(fits: FullFits, judged: list[tuple[FittedCandidate, float]]) -> list[tuple[FittedCandidate, float]]:
    """Return the candidates, those of a very large gain judged anew after a full fit of each.

    Beside a huge disagreement the linearised nuisances and the weights of the old model are poor judges.
    """
    huge = [fitted for fitted, nats in judged if nats > HUGE_NATS]
    if len(huge) < 2:
        return judged
    base = fits.state.evidence
    return [(fitted, fits.included(fitted.effect, far=True).evidence - base) for fitted in huge]


def rivals_of(chosen: Judged, judged: Sequence[Judged]) -> tuple[CatalogueEffect, ...]:
    """Return the effects, at their best parameters, that the data cannot separate from the chosen one.

    What the plan cannot separate, because a setting does not vary, is asked of the reported model (`inseparable`).

    Args:
        chosen: The chosen one with its gain in nats.
        judged: Others that were fitted and judged in the same way, with theirs.
    """
    return tuple({f.name: f.effect for f, nats in judged if _is_rival(f, nats, chosen)}.values())


def _is_rival(other: FittedCandidate, nats: float, chosen: Judged) -> bool:
    """Return whether another entry predicts about as well; each further parameter must be paid for.

    One with more parameters, one of them on its bound, imitates the chosen one in a limit: a kernel as wide as the
    picture is a veil.
    """
    further = max(other.parameters - chosen[0].parameters, 0)
    if other.name == chosen[0].name or (further and other.columns.shape[1] < other.parameters):
        return False
    return nats - PARAMETER_NATS * further > chosen[1] - RIVAL_NATS
