"""Changes a model with names: drops, swaps or joins names, loosens a law, or gives one name a free law.

What was named first knew nothing of what came later. Each move is judged by the score that also adds names: the
held-out log density, every parameter paid for.

A search adds what helps most, one name after the other, and comes to a looser form only by way of the plain one. A
cause that the plain form describes badly is then reported as several that correct each other (wings of stray light as
a display's gamma with a fall-off). Of models that predict equally well the one of a single cause is reported.

Where structure stays in the end, the names that were found may be one cause by another law than the catalogue's. Each
entry's change is then multiplied by a free curve along its own covariates (`simulators/effects/free_law.py`). It is
tried alone from the start on or in the place of a name, by the score of all models. It is kept where it leaves
nothing unexplained.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError, MeasurementError
from radiometer.reconciliation.fit.candidate_fit import Candidate, fit_candidate, judged_gain
from radiometer.reconciliation.fit.covariance import is_misfit
from radiometer.reconciliation.fit.descent import coarse_fit, converged_fit, refit
from radiometer.reconciliation.fit.full_fit import FullFits, UnfitError, contenders_of, included
from radiometer.reconciliation.fit.state import FitState, reweighted, with_effects, with_terms
from radiometer.reconciliation.search.score import likeliest, penalised_chi2, rated, worth
from radiometer.reconciliation.search.screening import StartPool, directions_of, screen
from radiometer.reconciliation.thresholds import (
    HUGE_NATS,
    KEPT_NATS,
    LAW_SHARE,
    NAMED_NATS,
    OWN_LAW_NATS,
    PARAMETER_NATS,
)
from radiometer.typing import Mask
from simulators.chain.stages import place_for
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw, axis_scale, axis_values, freed, unscaled
from simulators.effects.tile_moments import TileMoments

_EXCHANGED: Final = 4  # entries that are fitted in another's place
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
        smaller = with_terms(state, [other for other in smooth if other is not term])
        yield term.name, smaller.promised, smaller


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
        judged = [
            (fitted, judged_gain(rest, fitted)) for fitted in (fit_candidate(rest, c) for c in others[:_EXCHANGED])
        ]
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
            fitted = [
                fit_candidate(rest, Candidate(start, 0.0, len(start.free()) or 1)) for start in starts[:_EXCHANGED]
            ]
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
    # Nats that the likeliest would bring if they acted linearly, the places of their effects, the forms
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
        fitted = [_loosened(self.state, index, form) for _, index, form in self.promising]
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


def _loosened(state: FitState, index: int, form: CatalogueEffect) -> Loosened | None:
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


# ---- looser forms and free laws -------------------------------------------------------------------------------------


_KNOTS: Final = (5, 9)
_OF_TWO: Final = 6  # of the first of two covariates
_LEVELS: Final = 6  # of a covariate, each of which is a knot


def free_forms(state: FitState, effect: CatalogueEffect) -> tuple[FreeLaw, ...]:
    """Return an effect with a free law: along each of its covariates, and along two together.

    Args:
        state: The model, which gives the signals in front of the effect.
        effect: The effect by its own law.
    """
    if isinstance(effect, FreeLaw) or not effect.free() or any("[" in name for name in effect.free()):
        return ()
    along = effect.law_along or (effect.where,)
    knots = {axis: [_knots(state, effect, axis, count) for count in _KNOTS] for axis in along}
    single = [{axis: at} for axis, several in knots.items() for at in dict.fromkeys(several) if at]
    both = [
        {first: _knots(state, effect, first, _OF_TWO), second: knots[second][0]}
        for first, second in itertools.combinations(along, 2)
        if knots[first][0] and knots[second][0]
    ]
    return tuple(_freed(effect, at) for at in (*single, *both))


def _freed(effect: CatalogueEffect, at: Mapping[str, tuple[float, ...]]) -> FreeLaw:
    size = int(np.prod([len(values) for values in at.values()]))
    own = effect.values() | {"law": (1.0,) * size} | {f"at_{axis}": values for axis, values in at.items()}
    return freed(type(effect), tuple(at))(**own)


def _knots(state: FitState, effect: CatalogueEffect, axis: str, count: int) -> tuple[float, ...]:
    """Return the places of so many knots along a covariate; each of few levels is one, none where it does not vary."""
    before = state.trace.in_front(place_for(effect, state.trace.links))
    values = axis_values(effect, axis, before.mean, state.model.context)
    if values is None:
        return ()
    mask = state.comparison.usable["mean"][:, :, None] & _acts(state, effect, before)
    spread = np.broadcast_to(axis_scale(axis, values), np.broadcast_shapes(np.shape(values), mask.shape))
    held = spread[np.broadcast_to(mask, spread.shape)]
    levels = np.unique(np.round(held[np.isfinite(held)], 6))
    if levels.size < 2:
        return ()
    if levels.size > _LEVELS:
        share = np.linspace(0.0, 1.0, count)
        levels = 0.5 * (np.quantile(levels, share) + levels[0] + share * (levels[-1] - levels[0]))
    return tuple(unscaled(axis, levels).tolist())


def _acts(state: FitState, effect: CatalogueEffect, before: TileMoments) -> Mask:
    """Return where an effect does anything at all: elsewhere no law of it can be seen."""
    after = effect.moments(before, state.model.context)
    names = ("mean", *before.squared, *before.linear)
    moved = [np.not_equal(getattr(after, name), getattr(before, name)) for name in names]
    return np.asarray(np.broadcast_to(np.any(np.broadcast_arrays(*moved), axis=0), before.mean.shape))


_FORMS_FITTED: Final = 3  # forms that are fitted in full, the most promising first
_LOOSER: Final = 2  # times that the best entry alone is made looser
_NEAR: Final = 2.0  # times what was left beyond chance, under the same weights: a law that leaves more is far off
_FEW: Final = 6  # iterations that tell how the others do alone


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A model in which one name took a free law."""

    state: FitState  # the fitted model
    name: str  # the name
    without: FitState  # the model without that name
    rivals: tuple[CatalogueEffect, ...] = ()  # other entries that leave nothing by a law of theirs either

    @property
    def nats(self) -> float:
        """Return by how much the name by its free law raises the held-out log density."""
        return self.state.evidence - self.without.evidence

    @property
    def form(self) -> CatalogueEffect:
        """Return the effect with its free law."""
        return next(effect for effect in self.state.effects if effect.name == self.name)


def nowhere_near(base: FitState, found: FitState) -> float:
    """Return the χ² beyond which a single law that is fitted comes nowhere near what was found.

    Args:
        base: The model that the law is put into; its weights are those of the χ².
        found: What was found; curves without a name are left out.
    """
    left, count = base.comparison.residual(found.prediction), float(base.comparison.counts().sum())
    return count + _NEAR * max(float(left @ left) - count, 0.0) + 2.0 * HUGE_NATS


def in_a_looser_form(
    start: FitState, least: float, catalogue: Mapping[str, type[CatalogueEffect]], most: float = np.inf
) -> FitState | None:
    """Return the model with the entry of which a looser form alone does what others do; None where none does.

    What has no plain part (a black level that ramps and is nothing in the middle) a search does not meet.

    Args:
        start: The starting camera fitted.
        least: Score that the model needs.
        most: χ² under the weights of the start that a form may leave.
    """
    context, best = start.model.context, list[FitState]()
    several = [kind.starts(context) for kind in catalogue.values() if kind.usable(context)]
    plain = [min(starts, key=lambda entry: len(entry.free())) for starts in several if starts]
    for _ in range(_LOOSER):  # each time from the best so far
        forms = [form for entry in plain for form in entry.loosened(context)]
        promising = sorted(((promise(start, form), n) for n, form in enumerate(forms)), reverse=True)[:_FORMS_FITTED]
        fitted = (_alone(start, forms[n], most) for promised, n in promising if promised > 0)
        better = max((state for state in fitted if state is not None), key=rated, default=None)
        if better is None or (best and rated(better) <= rated(best[-1])):
            break
        best.append(better)
        plain = list(better.effects)
    return best[-1] if best and rated(best[-1]) > least else None


def _alone(start: FitState, form: CatalogueEffect, most: float) -> FitState | None:
    """Return the model with a form alone; None where it cannot be fitted."""
    try:
        return included(start, form, far=True, most=most)
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # what cannot be fitted does nothing
        return None


def in_place_of_all(
    start: FitState, state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]
) -> FitState | None:
    """Return the model with one entry in a looser form that predicts better than several names; None where none does.

    Args:
        start: The starting camera fitted.
        state: What was found: names, and curves without a name.
    """
    curves = sum(term.is_smooth for term in state.terms)
    if not state.effects or len(state.effects) + curves < 2:
        return None
    return in_a_looser_form(start, rated(state), catalogue, nowhere_near(start, state))


def by_a_free_law(start: FitState, state: FitState, alone: Sequence[CatalogueEffect]) -> Refined | None:
    """Return the model with one name by a free law that does better than all that was found; None for none.

    Args:
        start: The model without any name.
        state: What was found; structure stays in it.
        alone: Entries as they fit the start, each alone.
    """
    found = list[Refined]()
    for promises in (_of_one(start, alone), _in_place(start, state)):
        found += _tried(promises, state)
        if any(not is_misfit(refined.state) for refined in found):
            break
    if not found:
        return None
    best = max(found, key=lambda refined: worth(refined.state))
    closing = [refined for refined in found if not is_misfit(refined.state)]
    return replace(best, rivals=tuple({m.name: m.form for m in closing if m.name != best.name}.values()))


_Promise = tuple[float, FitState, FreeLaw]


def _tried(promises: Iterator[_Promise], state: FitState) -> Iterator[Refined]:
    """Yield the models of the most promising forms, one for each name, that are worth more than what was found."""
    least = worth(state)
    tried = set[str]()
    for _, base, form in sorted(promises, key=lambda entry: -entry[0]):
        if form.name not in tried and len(tried) < _FORMS_FITTED:
            tried.add(form.name)
            refined = _with_form(base, form, least, nowhere_near(base, state))
            if refined is not None:
                yield refined


def _of_one(start: FitState, alone: Sequence[CatalogueEffect]) -> Iterator[_Promise]:
    """Yield what free forms promise alone, the model that each is put into, and the form."""
    for effect in alone:
        for form in free_forms(start, effect):
            yield promise(start, form), start, form


def _in_place(start: FitState, state: FitState) -> Iterator[_Promise]:
    """Yield the same of forms in the place of a name, the other names kept."""
    for effect in state.effects if len(state.effects) > 1 else ():
        without = with_terms(with_effects(state, [other for other in state.effects if other is not effect]), ())
        base = refit(without, iterations=_FEW)
        for form in free_forms(base, effect):
            yield base.evidence - start.evidence + promise(base, form), base, form


def promise(base: FitState, form: CatalogueEffect) -> float:
    """Return the nats that a form would bring if it acted linearly, its parameters paid for.

    Args:
        base: The model without it.
        form: A form with a free law, or a looser one.
    """
    try:
        followed = base.fit.followed(directions_of(base, (*base.effects, form), len(base.effects)))
    except (MeasurementError, ConfigurationError):  # what no camera does
        return -np.inf
    return base.fit.score(slice(0, base.comparison.size), followed)[0] / 2.0 - PARAMETER_NATS * len(form.free())


def _with_form(base: FitState, form: FreeLaw, least: float, most: float) -> Refined | None:
    """Return the model with a form, fitted in full; None where its plain law is far from the result.

    None too where it is not worth more than `least`, or leaves more than `most` under the weights of the model without
    it; how far its plain law comes is not asked then.
    """
    try:
        state = included(base, form, far=True, most=most)
        if worth(state) <= least:
            return None
        plain = included(base, form.own, far=True)
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):
        return None
    brought, whole = plain.evidence - base.evidence, state.evidence - base.evidence
    if brought < LAW_SHARE * whole:
        return None
    return Refined(state, form.name, base)
