"""Changes a model with names: drops a name, swaps it for another, joins several into one, loosens a law.

What was named first knew nothing of what came later. Each move is judged by the score that also adds names: the
held-out log density, every parameter paid for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.fit.candidate_fit import Candidate, fit_candidate, judged_gain
from radiometer.reconciliation.fit.descent import coarse_fit, converged_fit, refit
from radiometer.reconciliation.fit.full_fit import FullFits, UnfitError, contenders_of, included
from radiometer.reconciliation.fit.state import FitState, reweighted, with_effects, with_terms
from radiometer.reconciliation.fit.terms import LinearTerm
from radiometer.reconciliation.search.score import likeliest, penalised_chi2
from radiometer.reconciliation.search.screening import StartPool, directions_of, screen
from radiometer.reconciliation.thresholds import HUGE_NATS, KEPT_NATS, NAMED_NATS, OWN_LAW_NATS, PARAMETER_NATS
from simulators.effects.catalogue import CatalogueEffect

_FITTED: Final = 4  # entries that are fitted in another's place
_FAR_OFF: Final = 400.0  # χ² that a smaller model leaves by its own derivatives still, and is asked no further
_REFITTED: Final = 2  # forms that are fitted in full, the most promising first


def pruned(state: FitState, say: Callable[[str], None]) -> tuple[FitState, list[str]]:
    """Drop earlier effects and unnamed terms that the newest made superfluous.

    Returns:
        The model that is left, and the names of what was dropped.
    """
    changed, dropped = True, list[str]()
    while changed:
        changed = False
        for name, promised, smaller in _without_one(state):
            if promised - state.cost > 2.0 * HUGE_NATS:  # the others, free to move, come nowhere near
                continue
            lost = _lost(state, smaller)
            if lost < KEPT_NATS:
                say(f"{name} dropped again: it brings {lost:.1f} nats")
                state, changed = refit(reweighted(refit(smaller))).recorded(), True
                dropped.append(name)
                break
    return state, dropped


def _lost(state: FitState, smaller: FitState) -> float:
    """Return by how many nats a smaller model predicts held-out settings worse; infinity where it is far off."""
    nearer = refit(smaller, iterations=1).with_frozen(frozenset())
    if nearer.promised - state.cost > _FAR_OFF:  # by derivatives of its own
        return np.inf
    return _log_density(state) - _log_density(refit(nearer, iterations=5).recorded())


def _without_one(state: FitState) -> Iterator[tuple[str, float, FitState]]:
    """Yield the models with one earlier addition less (the newest effect is not questioned), and the χ² they promise.

    What is left of an effect that is gone the others may take up as they do where it stands.
    """
    smooth = tuple(term for term in state.terms if term.is_smooth)
    older = state.effects[:-1] if not smooth else state.effects
    rests = [[other for other in state.effects if other is not effect] for effect in older]
    for index, (effect, change) in enumerate(zip(older, state.moved_by(rests).T, strict=True)):
        others = state.whole_fit.without(state.parameters.of_effect(index))
        residual = state.residual - state.pad(change[:, None])[:, 0]
        yield effect.name, others.left_from(residual), with_effects(state, rests[index])
    for term in smooth if state.effects else ():
        smaller = _without_term(state, smooth, term)
        yield term.name, smaller.promised, smaller


def _without_term(state: FitState, smooth: tuple[LinearTerm, ...], term: LinearTerm) -> FitState:
    return with_terms(state, [other for other in smooth if other is not term])


def _log_density(state: FitState) -> float:
    return float(np.sum(state.held_out.log_density))


def better(
    state: FitState, name: str, catalogue: Mapping[str, type[CatalogueEffect]], pool: StartPool
) -> tuple[FitState, CatalogueEffect] | None:
    """Return the model with another entry in place of one, where it predicts better together with what was named later.

    Returns:
        The model and the entry as it was fitted; None where no entry predicts better.
    """
    own = next(effect for effect in state.effects if effect.name == name)
    present = {effect.name for effect in state.effects}
    try:
        rest = converged_fit(coarse_fit(with_effects(state, [effect for effect in state.effects if effect is not own])))
        others = [candidate for candidate in screen(rest, catalogue, pool) if candidate.effect.name not in present]
        judged = [(fitted, judged_gain(rest, fitted)) for fitted in (fit_candidate(rest, c) for c in others[:_FITTED])]
        fits = FullFits(rest)
        chosen = likeliest(contenders_of(fits, judged))
        if chosen is None:
            return None
        fitted = chosen[0]
        changed = fits.included(fitted.effect, far=True)
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # what cannot be fitted takes no place
        return None
    more = PARAMETER_NATS * (changed.parameters.size - state.parameters.size)
    if changed.evidence - more < state.evidence + NAMED_NATS:
        return None
    return changed, next(effect for effect in changed.effects if effect.name == fitted.name)


def fit_swapped(state: FitState, others: Mapping[str, Sequence[CatalogueEffect]]) -> None:
    """Fit other entries in the place of each of several names, so that their models are compared with the names'.

    What was fitted at the step of a name did not know the later ones. The only name was compared at its step.

    Args:
        state: The model with all names.
        others: What was fitted with each name, the best first.
    """
    present = {effect.name for effect in state.effects}
    for effect in state.effects if len(state.effects) > 1 else ():
        starts = [other for other in others.get(effect.name, ()) if other.name not in present]
        if not starts:
            continue
        try:
            rest = with_effects(state, [other for other in state.effects if other is not effect])
            fitted = [fit_candidate(rest, Candidate(start, 0.0, len(start.free()) or 1)) for start in starts[:_FITTED]]
            best = max(fitted, key=penalised_chi2)
            judged_gain(rest, best)
            FullFits(rest).try_out(best.effect, far=False)
        except (np.linalg.LinAlgError, ConfigurationError):  # what cannot be fitted takes no place
            continue


def simpler(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> tuple[FitState, CatalogueEffect] | None:
    """Return the model with one entry in place of those that it may replace, where fewer parameters predict as well.

    Each parameter that is saved is worth what a further one must bring.

    Returns:
        The model and the entry as it was fitted; None where no entry predicts as well.
    """
    present = {effect.name: len(effect.free()) for effect in state.effects}
    for name, kind in catalogue.items():
        if not kind.stands_for or name in present or not present.keys() >= set(kind.stands_for):
            continue
        start = kind.in_place_of_others()
        saved = PARAMETER_NATS * (sum(present[other] for other in kind.stands_for) - len(start.free()))
        if saved <= 0:
            continue
        try:
            rest = [effect for effect in state.effects if effect.name not in kind.stands_for]
            joined = included(with_effects(state, rest), start, far=True)
        except UnfitError:
            continue
        if joined.evidence + saved > state.evidence:
            return joined, next(effect for effect in joined.effects if effect.name == name)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class Loosened:
    """A model in which one effect took a more flexible form."""

    name: str  # name of the effect
    state: FitState  # the fitted model
    nats: float  # improvement of the held-out log density
    further: int  # number of parameters that the form has beyond the former one


@dataclass(eq=False)
class LooserForms:
    """The forms that may do more than those of the effects in a model; they are fitted where they are asked for.

    Each further parameter must be paid for, and the whole be as far beyond chance as a further name.
    """

    state: FitState  # the model
    needed: float  # nats that a form must bring
    # nats that the likeliest would bring if they acted linearly, the places of their effects, the forms
    promising: list[tuple[float, int, CatalogueEffect]]

    @classmethod
    def of(cls, state: FitState, only: Sequence[str] | None = None) -> LooserForms:
        """Return the forms of the effects of a model.

        Args:
            only: Names of the effects that leave structure in their own place, where these alone are asked and the
                tests of that place are what is beyond chance; by default all effects.
        """
        needed = NAMED_NATS if only is None else OWN_LAW_NATS
        forms = (form for form in _promising(state, only) if form[0] >= needed)
        return cls(state, needed, sorted(forms, key=lambda entry: -entry[0])[:_REFITTED])

    @property
    def promise(self) -> float:
        """Return the nats that the likeliest form would bring if it acted linearly."""
        return max((nats for nats, _, _ in self.promising), default=0.0)

    @cached_property
    def best(self) -> Loosened | None:
        """Return the model with the form that predicts held-out settings best; None where none is worth it."""
        fitted = [_fitted(self.state, index, form) for _, index, form in self.promising]
        worth = [e for e in fitted if e is not None and e.nats - PARAMETER_NATS * e.further >= self.needed]
        return max(worth, key=lambda entry: entry.nats - PARAMETER_NATS * entry.further, default=None)


def _promising(state: FitState, only: Sequence[str] | None) -> Iterator[tuple[float, int, CatalogueEffect]]:
    """Yield nats that each form would bring if it acted linearly, the place of its effect, and the form."""
    for index, effect in enumerate(state.effects):
        if only is not None and effect.name not in only:
            continue
        for form in effect.loosened(state.model.context):
            yield _linear_gain(state, index, form) / 2.0 - PARAMETER_NATS * _further(effect, form), index, form


def _further(effect: CatalogueEffect, form: CatalogueEffect) -> int:
    return max(len(form.free()) - len(effect.free()), 1)


def _linear_gain(state: FitState, index: int, form: CatalogueEffect) -> float:
    """Return the χ² that a form in an effect's place explains by itself and by its parameters' directions."""
    effects = [form if place == index else effect for place, effect in enumerate(state.effects)]
    followed = state.fit.followed(directions_of(state, effects, index))
    return state.fit.score(slice(0, state.comparison.size), followed)[0]


def _fitted(state: FitState, index: int, form: CatalogueEffect) -> Loosened | None:
    """Return the model with a form in an effect's place, fitted; it stands last, as the newest of all.

    None where the form cannot be fitted: with it the model predicts what no camera does.
    """
    others = [effect for place, effect in enumerate(state.effects) if place != index]
    try:
        following = converged_fit(coarse_fit(with_effects(state, [*others, form])))
    except (np.linalg.LinAlgError, ConfigurationError):  # no covariance, or parameters that are no numbers
        return None
    further = _further(state.effects[index], form)
    return Loosened(form.name, following, following.evidence - state.evidence, further)
