"""Names missing effects one after the other until nothing structured is left.

What was named first knew nothing of what came later. Names are dropped, laws loosened, or one name given a free law.
Each move is judged by the score that also adds names: the held-out log density, every parameter paid for.

Where structure stays in the end, the names that were found may be one cause by another law than the catalogue's. Each
entry's change is then multiplied by a free curve along its own covariates (`simulators/effects/free_law.py`). It is
tried alone from the start on or in the place of a name, by the score of all models. It is kept where it leaves
nothing unexplained.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.fit.candidate_fit import (
    Candidate,
    FittedCandidate,
    curve_gain,
    fit_candidate,
    judged_gain,
)
from radiometer.reconciliation.fit.descent import (
    UnfitError,
    coarse_fit,
    converged_fit,
    included,
    is_misfit,
    refit,
    scatter_of,
)
from radiometer.reconciliation.fit.state import FitState, reweighted, with_effects, with_terms
from radiometer.reconciliation.search.localise import Disagreement, departing, localise, significant, smooth_term
from radiometer.reconciliation.search.outcome import (
    Contender,
    Search,
    Step,
    contenders_of,
    penalised_chi2,
    rated,
    rivals_of,
)
from radiometer.reconciliation.search.screening import StartPool, directions_of, screen
from radiometer.reconciliation.statistics import STATISTICS, Scale
from radiometer.reconciliation.thresholds import (
    NAMED_NATS,
    PARAMETER_NATS,
    RIVAL_NATS,
    SIGNIFICANCE,
    SMOOTH_SHARE,
)
from radiometer.statistics.chances import chi2_beyond
from radiometer.typing import Mask
from simulators.chain.stages import place_for
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw, axis_scale, axis_values, freed, unscaled
from simulators.effects.tile_moments import TileMoments

_MOST_STEPS: Final = 12  # bounds the time: a CCD's darks show nine effects, two in freer forms
_FITTED: Final = 7  # candidates that are fitted in each step
_JUDGED: Final = 4  # of them, those that are judged on held-out settings
_SMOOTHS_TRIED: Final = 4
_NEAR_FORM: Final = 0.5
_LITTLE_PROMISE: Final = 0.05  # of what a further effect brings: forms came to eleven times their promise at most


@dataclass(slots=True)
class _Run:
    catalogue: Mapping[str, type[CatalogueEffect]]
    say: Callable[[str], None]
    steps: list[Step] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    pool: StartPool = field(default_factory=StartPool)
    screened: list[Candidate] = field(default_factory=list)  # next to the model before
    forms: dict[tuple[str, bool], tuple[CatalogueEffect, ...]] = field(default_factory=dict)  # as they were fitted then
    fitted_with: dict[str, tuple[CatalogueEffect, ...]] = field(default_factory=dict)  # what was fitted with each name


def search(
    start: FitState, catalogue: Mapping[str, type[CatalogueEffect]], say: Callable[[str], None] = lambda line: None
) -> Search:
    """Return the model with every missing effect that the data can name.

    Args:
        start: The ideal camera fitted.
        catalogue: Entries to try, by name.
        say: Told what happens, line by line.
    """
    run, first = _Run(catalogue, say), localise(start)
    state, tests = _stepped(start, first, run)
    likeliest, taken = swapped(state, run.fitted_with)
    if taken:
        say("; ".join(f"{effect.name} in place of {name}" for name, effect in taken.items()))
        run.steps = [_renamed(step, taken.get(step.name), likeliest) for step in run.steps]
        state, dropped = pruned(likeliest, say)  # what stood next to another name may be superfluous next to this one
        for name in dropped:
            _forget(run, name)
        tests = localise(state)
    return Search(state, start, tuple(run.steps), significant(tests), tests, first)


def _renamed(step: Step, effect: CatalogueEffect | None, state: FitState) -> Step:
    """Return the step of a name with the entry that took its place, if any."""
    if effect is None:
        return step
    return replace(step, name=effect.name, where=effect.where, gap_after=state.gap, rivals=())


def _stepped(state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> tuple[FitState, tuple[Disagreement, ...]]:
    """Return the model after all steps, and its tests."""
    for _ in range(_MOST_STEPS):
        following = _one_step(state, tests, run)
        if following is None:
            break
        state, dropped = pruned(following, run.say)
        for name in dropped:
            _forget(run, name)
        if dropped:  # rivals were judged next to what is gone; what the plan cannot separate is determined again
            run.steps = [replace(step, rivals=()) for step in run.steps]
        tests = localise(state)
    return state, tests


def _one_step(state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> FitState | None:
    standing = significant(tests)
    screened = run.screened = screen(state, run.catalogue, run.pool, run.screened, _FITTED + len(run.refused))
    limit = SIGNIFICANCE / max(len(screened), 1)
    promising = _promising(screened, limit, standing)
    promising = [candidate for candidate in promising if candidate.effect.name not in run.refused]
    departed = [] if standing else departing(tests, state.effects)
    if not standing and not promising and not departed:
        return None
    all_fitted = (_fitted(state, candidate, run) for candidate in promising[:_FITTED])
    fitted = sorted((f for f in all_fitted if not f.effect.is_nothing()), key=lambda f: -penalised_chi2(f))
    judged = [(f, judged_gain(state, f)) for f in fitted[:_JUDGED]]
    contenders = contenders_of(state, [f for f, nats in judged if nats >= NAMED_NATS - RIVAL_NATS])
    shown = sorted((entry for entry in contenders if entry.is_shown), key=lambda entry: -entry.score)
    looser = LooserForms.of(state, None if standing else departed)
    for chosen in shown[:1]:
        if _convinces(state, chosen, standing) and not _is_likelier(looser, chosen):
            run.fitted_with[chosen.fitted.name] = tuple(f.effect for f in fitted if f.name != chosen.fitted.name)
            return _named(state, chosen, contenders, run)
    if looser.best is not None:
        return _taken(state, looser.best, run)
    return _unnamed(state, standing, judged, run) if standing else None


def _fitted(state: FitState, candidate: Candidate, run: _Run) -> FittedCandidate:
    """Return a candidate fitted; it begins from its fit with the model before, too."""
    key = (candidate.effect.name, candidate.flexible)
    found = fit_candidate(state, replace(candidate, others=(*candidate.others, *run.forms.get(key, ()))))
    run.forms[key] = found.forms
    return found


def _is_likelier(looser: LooserForms, chosen: Contender) -> bool:
    """Return whether another form of an effect that is there predicts better than a further effect.

    The form is fitted in full, unless it promises too little.
    """
    if looser.promise < _LITTLE_PROMISE * chosen.score or looser.best is None:
        return False
    return looser.best.nats - PARAMETER_NATS * looser.best.further - RIVAL_NATS > chosen.score


def _taken(state: FitState, looser: Loosened, run: _Run) -> FitState:
    at = next(i for i, step in enumerate(run.steps) if step.name == looser.name)
    gap = looser.state.gap
    run.steps[at] = replace(run.steps[at], gain_nats=run.steps[at].gain_nats + looser.nats, gap_after=gap)
    run.say(f"{looser.name} in a more flexible form: {looser.nats:.1f} nats, gap {state.gap:.3f} → {gap:.3f}")
    return looser.state


def _promising(candidates: list[Candidate], limit: float, standing: tuple[Disagreement, ...]) -> list[Candidate]:
    """Return candidates whose gain is significant among all that were tried, or may yet become so."""
    slack = 0.5 if standing else 1.0  # a start far from the best parameters shows only part of its gain
    return [c for c in candidates if chi2_beyond(max(c.gain, 1e-9), c.parameters) < limit**slack]


def _convinces(state: FitState, chosen: Contender, standing: tuple[Disagreement, ...]) -> bool:
    same = [test for test in standing if test.family == chosen.fitted.effect.block]
    if not same:
        return True
    smooth = _smooth_gain(state, same[0])
    return chosen.nats >= SMOOTH_SHARE * smooth or chosen.nats >= smooth - NAMED_NATS


def _smooth_gain(state: FitState, test: Disagreement) -> float:
    term = smooth_term(state, test)
    columns = state.pad(term.build(state.comparison, state.prediction, state.sensitivity))
    return curve_gain(state, state.fit.followed(columns))


def _named(state: FitState, chosen: Contender, contenders: Sequence[Contender], run: _Run) -> FitState:
    """Return the model with the chosen effect."""
    effect, gap = chosen.fitted.effect, chosen.state.gap
    again = next((i for i, step in enumerate(run.steps) if step.name == effect.name), None)
    if again is None:
        rivals = rivals_of(chosen, contenders)
        run.steps.append(Step(effect.name, effect.where, chosen.nats, state.gap, gap, rivals))
    else:
        old = run.steps[again]
        run.steps[again] = replace(old, gain_nats=old.gain_nats + chosen.nats, gap_after=gap)
    run.say(f"{effect.name}: {chosen.nats:.1f} nats, gap {state.gap:.3f} → {gap:.3f}")
    return chosen.state


def _unnamed(
    state: FitState,
    standing: tuple[Disagreement, ...],
    judged: list[tuple[FittedCandidate, float]],
    run: _Run,
) -> FitState | None:
    tried = {old.name for old in state.terms} | run.refused
    fresh = [t for t in standing if smooth_term(state, t).name not in tried and not _too_few(state, t.block)]
    rated = ((test, _smooth_gain(state, test)) for test in fresh[:_SMOOTHS_TRIED])
    worthy = ((test, nats) for test, nats in rated if nats > PARAMETER_NATS * scatter_of(state))
    old = tuple(term for term in state.terms if term.is_smooth)
    curved = ((test, nats, with_terms(state, (*old, smooth_term(state, test)))) for test, nats in worthy)
    tried_out = ((test, nats, refit(reweighted(refit(model))).recorded()) for test, nats, model in curved)
    found = next((entry for entry in tried_out if entry[2].evidence > state.evidence), None)
    if found is None:
        return None
    test, nats, following = found
    fitting = [entry for entry in judged if entry[0].effect.block == test.family]
    best = max(fitting, key=lambda entry: entry[1], default=None)
    closest = (best[0].name, float(np.clip(best[1] / max(nats, 1e-9), 0.0, 1.0))) if best else None
    run.steps.append(Step("unnamed", test.where, nats, state.gap, following.gap, closest=closest, block=test.family))
    run.say(f"unnamed {smooth_term(state, test).name}: {nats:.1f} nats, gap {state.gap:.3f} → {following.gap:.3f}")
    return following


def _too_few(state: FitState, block: str) -> bool:
    """Return whether fewer pixels count than names predict: that refutes a name, for what stays unnamed only adds."""
    left = state.residual[state.comparison.cuts[block]]
    return STATISTICS[block].scale is Scale.ROOT and float(left.sum()) < 0


def _forget(run: _Run, name: str) -> None:
    where = name.split(" | ")
    run.refused.add(name)
    for step in list(run.steps):
        if step.name == name or (step.name == "unnamed" and len(where) > 1 and step.where == where[1]):
            run.steps.remove(step)
            break


# ---- changes of a model with names ----------------------------------------------------------------------------------


_SWAPPED: Final = 4  # entries that are fitted in another's place
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
        for name, smaller in _without_one(state):
            lost = _lost(state, smaller)
            if lost < PARAMETER_NATS:
                say(f"{name} dropped again: it brings {lost:.1f} nats")
                state, changed = refit(reweighted(refit(smaller))).recorded(), True
                dropped.append(name)
                break
    return state, dropped


def _lost(state: FitState, smaller: FitState) -> float:
    """Return by how many nats a smaller model predicts held-out settings worse; infinity where it is far off."""
    nearer = refit(smaller, iterations=1).with_frozen(frozenset())
    if nearer.promised - state.cost > _FAR_OFF:  # by its derivatives
        return np.inf
    return _log_density(state) - _log_density(refit(nearer, iterations=5).recorded())


def _without_one(state: FitState) -> Iterator[tuple[str, FitState]]:
    """Yield the models with one earlier addition less; the newest effect is not questioned."""
    smooth = tuple(term for term in state.terms if term.is_smooth)
    for effect in state.effects if smooth else state.effects[:-1]:
        yield effect.name, with_effects(state, [other for other in state.effects if other is not effect])
    for term in smooth if state.effects else ():
        yield term.name, with_terms(state, [other for other in smooth if other is not term])


def _log_density(state: FitState) -> float:
    return float(np.sum(state.held_out.log_density))


def swapped(
    state: FitState, others: Mapping[str, Sequence[CatalogueEffect]]
) -> tuple[FitState, dict[str, CatalogueEffect]]:
    """Return the model with other entries in the place of names, where that is likelier, and these by the names.

    What was fitted at the step of a name did not know the later ones. The only name was compared at its step.

    Args:
        state: The model with all names.
        others: What was fitted with each name, the best first.
    """
    taken = dict[str, CatalogueEffect]()
    for effect in state.effects if len(state.effects) > 1 else ():
        present = {other.name for other in state.effects}
        starts = [other for other in others.get(effect.name, ()) if other.name not in present]
        if not starts:
            continue
        try:
            rest = with_effects(state, [other for other in state.effects if other.name != effect.name])
            fitted = [fit_candidate(rest, Candidate(start, 0.0, len(start.free()) or 1)) for start in starts[:_SWAPPED]]
            best = max(fitted, key=penalised_chi2)
            judged_gain(rest, best)
            changed = included(rest, best.effect)
        except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # what cannot be fitted takes no place
            continue
        if rated(changed) > rated(state) and not is_misfit(changed):  # else it takes up the residual of others
            state, taken[effect.name] = changed, changed.effects[-1]
    return state, taken


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
        needed = NAMED_NATS if only is None else 0.0
        forms = (form for form in _forms_of_promise(state, only) if form[0] >= needed)
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


def _forms_of_promise(state: FitState, only: Sequence[str] | None) -> Iterator[tuple[float, int, CatalogueEffect]]:
    """Yield nats that each form would bring if it acted linearly, the place of its effect, and the form."""
    for index, effect in enumerate(state.effects):
        if only is not None and effect.name not in only:
            continue
        for form in (*effect.loosened(state.model.context), *free_forms(state, effect)):
            effects = [form if place == index else other for place, other in enumerate(state.effects)]
            nats = _linear_gain(state, effects, index) / 2.0 - PARAMETER_NATS * _further(effect, form)
            yield nats, index, form


def _further(effect: CatalogueEffect, form: CatalogueEffect) -> int:
    return max(len(form.free()) - len(effect.free()), 1)


def _linear_gain(state: FitState, effects: Sequence[CatalogueEffect], index: int) -> float:
    """Return the χ² that one of some effects, instead of the model's, explains by itself and by its parameters."""
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
