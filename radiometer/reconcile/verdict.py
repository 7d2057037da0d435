"""What a search comes to: whether its names stand, and what speaks against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Final

from radiometer.reconcile.fit.covariance import fitted_parameters
from radiometer.reconcile.fit.state import FitState, refit, with_effects
from radiometer.reconcile.report.result import Verdict
from radiometer.reconcile.search.excess import (
    contested,
    hollow,
    is_scattered,
    merged,
    outdone,
    replaceable,
)
from radiometer.reconcile.search.own_law import unlike
from radiometer.reconcile.search.search import Search

_PUSH: Final = 9.0  # χ² that the end of a range must bring to count: what the data hardly tell runs there by chance
_REFITS: Final = 8


def verdict_of(outcome: Search, doubts: Sequence[str]) -> Verdict:
    """Return what a search comes to.

    Args:
        outcome: The search.
        doubts: What speaks against its names.
    """
    named = bool(outcome.state.effects)
    unnamed = bool(outcome.left) or any(step.name == "unnamed" for step in outcome.steps)
    unnamed = unnamed or is_scattered(outcome.state)
    if named:
        return Verdict.INCOMPLETE if unnamed or doubts else Verdict.EFFECTS_FOUND
    return Verdict.UNNAMED if unnamed else Verdict.AGREES


def doubts_of(outcome: Search) -> list[str]:
    """Return in words why names are provisional though nothing structured is left."""
    state, effects = outcome.state, outcome.state.effects
    said = [f"{name} ran to the end of its range: what the data hold is not quite that" for name in _strained(state)]
    said += [f"{name} alone may do what all the names do together" for name in replaceable(outcome.steps, effects)]
    said += [
        f"{name} is only the likelier of two, the other predicts better" for name in outdone(outcome.steps, effects)
    ]
    said += [
        f"{name} fits by its further terms alone: what makes it {name} is within three uncertainties of zero"
        for name in hollow(effects, fitted_parameters(state))
    ]
    said += [f"{name} acts with these parameters as other causes would: nothing is its own" for name in merged(state)]
    said += [
        f"{name} brings little, and may be another entry or the rest of one"
        for name in contested(outcome.steps, effects)
    ]
    said += [
        f"{name} is not quite the law that the data follow: some of it stays where it shows"
        for name in unlike(outcome.tests, effects)
    ]
    return said


def _strained(state: FitState) -> list[str]:
    """Return what parameters the data push out of their physical range: the entry is bent to what it is not."""
    own = state.parameters
    ends = [index for index in sorted(state.frozen) if own.values[index] != 0.0]
    ends = [index for index in ends if own.names[index] not in own.effects[own.owner[index]].endless]
    return [
        f"{own.names[index]} of {own.effects[own.owner[index]].name}" for index in ends if _push(state, index) > _PUSH
    ]


def _push(state: FitState, index: int) -> float:
    """Return the χ² that a parameter gains by the end of its range over its usual value, all others fitted anew."""
    own = state.parameters
    effect, name = own.effects[own.owner[index]], own.names[index]
    usual = {entry.name: entry.default for entry in fields(effect)}.get(name)
    if not isinstance(usual, float):
        return 0.0
    values = own.values
    values[index] = usual
    moved = with_effects(state, own.replaced(values))
    if moved.parameters.size == own.size:  # else the effect is rigid there: the parameter is none of its free ones
        moved = replace(moved, frozen=frozenset({index}))
    return refit(moved, iterations=_REFITS).cost - state.cost
