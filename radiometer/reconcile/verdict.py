"""What a search comes to: whether its names stand, and what speaks against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Final

import numpy as np

from radiometer.reconcile.fit.comparison import Comparison
from radiometer.reconcile.fit.covariance import fitted_parameters
from radiometer.reconcile.fit.state import FitState, refit, with_effects
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.report.result import FittedParameter, FoundEffect, Verdict
from radiometer.reconcile.search.excess import (
    LITTLE_NATS,
    contested,
    hollow,
    is_scattered,
    merged,
    outdone,
    place_of_scatter,
    replaceable,
)
from radiometer.reconcile.search.frame_order import Periodic
from radiometer.reconcile.search.own_law import unlike
from radiometer.reconcile.search.places import axis_of
from radiometer.reconcile.search.search import Search

_PUSH: Final = 9.0  # χ² that the end of a range must bring to count: what the data hardly tell runs there by chance
_REFITS: Final = 8
_LIT_DN: Final = 1.0  # light below which a share of it says nothing


def verdict_of(outcome: Search, doubts: Sequence[str], again: Periodic | None = None) -> Verdict:
    """Return what a search comes to.

    Args:
        outcome: The search.
        doubts: What speaks against its names.
        again: What comes back in the order of the frames, which no name explains.
    """
    named = bool(outcome.state.effects)
    unnamed = _leaves_structure(outcome) or again is not None
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


def _leaves_structure(outcome: Search) -> bool:
    unnamed = bool(outcome.left) or any(step.name == "unnamed" for step in outcome.steps)
    return unnamed or is_scattered(outcome.state)


def faint_names(outcome: Search) -> list[str]:
    """Return names that are not worth telling: faint beside a stronger one, where structure stays anyhow.

    What a wrong law of the stronger one leaves, others take up in part.
    """
    present = {effect.name for effect in outcome.state.effects}
    named = [step for step in outcome.steps if step.name in present]
    most = max((step.gain_nats for step in named), default=0.0)
    if not _leaves_structure(outcome):
        return []
    return [step.name for step in named if step.gain_nats < min(LITTLE_NATS, most)]


def faint(outcome: Search) -> list[str]:
    """Return in words which names are left out."""
    gains = {step.name: step.gain_nats for step in outcome.steps}
    return [
        f"{name} is counted to what is left: it brings {gains[name]:.0f} nats where structure stays beside more"
        for name in faint_names(outcome)
    ]


def rest_of(outcome: Search, again: Periodic | None = None) -> FoundEffect | None:
    """Return all that is left without a name as one entry: its clearest place, its size, and where else it lies.

    Args:
        outcome: The search.
        again: What comes back in the order of the frames.
    """
    state = outcome.state
    steps = [step for step in outcome.steps if step.name == "unnamed"]
    places = [(axis_of(step.where, step.block), step.block) for step in steps]
    places += [(axis_of(test.where, test.block), test.family) for test in outcome.left]
    weak = faint_names(outcome)
    places += [(step.where, "") for step in outcome.steps if step.name in weak]
    if not places and is_scattered(state):
        block, where = place_of_scatter(state)
        places = [(where, block)]
    if again is not None:
        places.insert(0, ("frame", "common"))
    if not places:
        return None
    (where, block), *others = dict.fromkeys(places)
    before, after = (steps[0].gap_before, steps[-1].gap_after) if steps else (state.gap, state.gap)
    return FoundEffect(
        "unnamed",
        _period(again) if again is not None else size_of_rest(state, block),
        where,
        before,
        after,
        gain_nats=sum(step.gain_nats for step in steps),
        block=block,
        closest=steps[0].closest if steps and again is None else None,
        elsewhere=tuple(others),
    )


def _period(again: Periodic) -> dict[str, FittedParameter]:
    return {
        "period_frames": FittedParameter(float(again.period), None, "1"),
        "depth_rel": FittedParameter(again.depth, None, "1"),
    }


def size_of_rest(state: FitState, block: str) -> dict[str, FittedParameter]:
    """Return how large what is left is, root mean square: of means in DN, e⁻ and of the light, of noise relative.

    It is what the unnamed terms took up; where there are none, what the residual holds beyond its uncertainties.

    Args:
        state: The fitted model.
        block: Statistic that shows it.
    """
    comparison = state.comparison
    if block in ("variance", "spatial"):
        mask, left = comparison.usable[block], _taken_up(state, block)
        relative = float(np.sqrt(np.mean(np.square(_unwhitened(comparison, block, left)[mask]))))
        return {"rms_rel": FittedParameter(relative, None, "1")} if relative > 0 else {}
    if block != "mean":
        return {}
    mask = comparison.usable["mean"]
    dn = _unwhitened(comparison, "mean", _taken_up(state, "mean"))
    in_e = dn / np.maximum(state.prediction.gain[:, None], 1e-12)
    lit = mask & (state.sensitivity > _LIT_DN)
    found = {"rms_dn": (dn[mask], "DN"), "rms_e": (in_e[mask], "e-")}
    found |= {"rms_rel": (dn[lit] / state.sensitivity[lit], "1")} if lit.any() else {}
    sizes = {name: (float(np.sqrt(np.mean(np.square(values)))), unit) for name, (values, unit) in found.items()}
    return {name: FittedParameter(size, None, unit) for name, (size, unit) in sizes.items() if size > 0}


def _unwhitened(comparison: Comparison, block: str, values: Array) -> Array:
    """Return what whitened entries of a statistic are in its own unit, (captures, tiles)."""
    if block in comparison.whiteners:
        return np.asarray(np.linalg.solve(comparison.whiteners[block], values[..., None])[..., 0])
    return np.asarray(np.where(comparison.usable[block], values * comparison.deviation[block], 0.0))


def _taken_up(state: FitState, block: str) -> Array:
    """Return the whitened residual of one statistic that unnamed terms took up, or else its excess, as it is shaped."""
    comparison = state.comparison
    cut, shape = comparison.cuts[block], comparison.usable[block].shape
    taken, at = np.zeros(comparison.size), 0
    for term in state.terms:
        if term.is_smooth:
            columns = term.build(comparison, state.prediction, state.sensitivity)
            taken = taken + columns @ state.weights[at : at + term.size]
        at += term.size
    if taken[cut].any():
        return np.asarray(taken[cut].reshape(shape))
    left = state.data_residual[cut]
    more = max(1.0 - comparison.degrees(block) / max(float(left @ left), 1e-300), 0.0)
    return np.asarray(left.reshape(shape) * np.sqrt(more))


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
