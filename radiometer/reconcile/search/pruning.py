"""Drops what was named or taken up before and brings nothing any more."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from radiometer.reconcile.fit.state import FitState, refit, reweighted, with_effects, with_terms
from radiometer.reconcile.fit.terms import LinearTerm

KEPT_NATS: Final = 4.0  # an earlier name that brings less than this after a new one is dropped


def pruned(state: FitState, say: Callable[[str], None]) -> tuple[FitState, list[str]]:
    """Drop earlier effects and unnamed terms that bring nothing beside the newest.

    Args:
        state: The model with the newest.
        say: Told what is dropped.

    Returns:
        The model that is left, and the names of what was dropped.
    """
    changed, dropped = True, list[str]()
    while changed:
        changed = False
        for name, smaller in _without_one(state):
            lost = _log_density(state) - _log_density(refit(smaller, iterations=6))
            if lost < KEPT_NATS:
                say(f"{name} dropped again: it brings {lost:.1f} nats")
                state, changed = refit(reweighted(refit(smaller))), True
                dropped.append(name)
                break
    return state, dropped


def _without_one(state: FitState) -> list[tuple[str, FitState]]:
    """Return the models with one earlier addition less (the newest effect is not questioned)."""
    smooth = tuple(term for term in state.terms if term.is_smooth)
    found: list[tuple[str, FitState]] = []
    for index, effect in enumerate(state.effects[:-1] if not smooth else state.effects):
        rest = [e for i, e in enumerate(state.effects) if i != index]
        found.append((effect.name, with_effects(state, rest)))
    if state.effects:
        found += [(term.name, _without_term(state, smooth, term)) for term in smooth]
    return found


def _without_term(state: FitState, smooth: tuple[LinearTerm, ...], term: LinearTerm) -> FitState:
    return with_terms(state, [other for other in smooth if other is not term])


def _log_density(state: FitState) -> float:
    return float(np.sum(state.held_out.log_density))
