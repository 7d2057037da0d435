"""Holds the outcome of a search, and the one score by which its models are compared.

The score is the held-out log density plus the log prior odds of the names, each parameter paid for.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.reconciliation.fit.candidate_fit import FittedCandidate
from radiometer.reconciliation.fit.descent import UnfitError, included, scatter_of
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.result import ReconcileResult
from radiometer.reconciliation.search.localise import Disagreement
from radiometer.reconciliation.thresholds import (
    ESSENTIAL_SIGMAS,
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
@dataclass(frozen=True, eq=False)
class Contender:
    """A candidate after a full fit of all that is in the model."""

    fitted: FittedCandidate  # as it was fitted, the nuisances following linearly
    state: FitState  # the model with it
    nats: float  # improvement of the held-out log density

    @property
    def score(self) -> float:
        """Return its nats less what it pays; a flexible form pays as much as separates rivals."""
        return self.nats - _penalty(self.fitted) - (RIVAL_NATS if self.fitted.start.flexible else 0.0)

    @property
    def is_shown(self) -> bool:
        """Return whether settings held out are predicted better, and in the statistic that must show it too.

        Of many starts one fits by chance. Scatter that stays makes nats worth less.
        """
        needed = NAMED_NATS - self.fitted.effect.log_prior_odds + float(np.log(self.fitted.start.tries))
        needed += RIVAL_NATS if self.fitted.start.flexible else 0.0
        enough = max(needed, NAMED_NATS * scatter_of(self.state))
        return self.nats >= enough and self.fitted.evidence >= ESSENTIAL_SIGMAS**2


def contenders_of(state: FitState, candidates: Sequence[FittedCandidate]) -> list[Contender]:
    """Return candidates after a full fit of each; one with which the model predicts what no camera does is left out."""
    found = []
    for fitted in candidates:
        with contextlib.suppress(UnfitError):
            with_it = included(state, fitted.effect)
            found.append(Contender(fitted, with_it, with_it.evidence - state.evidence))
    return found


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
    return PARAMETER_NATS * fitted.start.parameters - fitted.effect.log_prior_odds


def rivals_of(chosen: Contender, contenders: Sequence[Contender]) -> tuple[CatalogueEffect, ...]:
    """Return the effects, at their best parameters, that the data cannot separate from the chosen one.

    Each further parameter must be paid for. One with more parameters, one of them on its bound, imitates the chosen one
    in a limit: a kernel as wide as the picture is a veil. What the plan cannot separate, because a setting does not
    vary, is asked of the reported model (`inseparable`).
    """
    found = {}
    for other in contenders:
        fitted, further = other.fitted, max(other.fitted.start.parameters - chosen.fitted.start.parameters, 0)
        on_bound = further and fitted.columns.shape[1] < fitted.start.parameters
        near = other.nats - PARAMETER_NATS * further > chosen.nats - RIVAL_NATS
        if near and not on_bound and fitted.name != chosen.fitted.name:
            found[fitted.name] = fitted.effect
    return tuple(found.values())
