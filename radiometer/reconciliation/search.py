"""Names missing effects one after the other until nothing structured is left.

What was named first knew nothing of what came later. Names are dropped, laws loosened, or one name gives way to
another. Each move is judged by the score that also adds names: the held-out log density plus the log prior odds of the
names, each parameter paid for.

Where a name's equation leaves structure, its change may be multiplied by a free curve along its own covariates
(`simulators/effects/free_law.py`). That is one more flexible form of it.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.descent import (
    Candidate,
    FittedCandidate,
    UnfitError,
    coarse_fit,
    converged_fit,
    curve_gain,
    fit_candidate,
    included,
    is_misfit,
    judged_gain,
    refit,
    scatter_of,
)
from radiometer.reconciliation.localise import Disagreement, departing, localise, significant, smooth_term
from radiometer.reconciliation.result import ReconcileResult
from radiometer.reconciliation.screening import StartPool, directions_of, screen
from radiometer.reconciliation.state import FitState, reweighted, with_effects, with_terms
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
    tests: tuple[Disagreement, ...]  # all tests of the final model
    first_tests: tuple[Disagreement, ...]  # all tests of the ideal camera
    remarks: tuple[str, ...] = ()  # further remarks on how it came about

    @property
    def left(self) -> tuple[Disagreement, ...]:
        """Return the disagreements that stay significant."""
        return significant(self.tests)


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
        return self.nats >= enough and self.fitted.evidence >= 2.0 * RIVAL_NATS


def contenders_of(state: FitState, candidates: Sequence[FittedCandidate]) -> list[Contender]:
    """Return candidates after a full fit of each; one with which the model predicts what no camera does is left out."""
    found = []
    for fitted in candidates:
        with contextlib.suppress(UnfitError):
            with_it = included(state, fitted.effect)
            fairly = with_it.models[-1].log_density.copy()
            fairly[: state.settings] -= fitted.overrated / state.settings
            with_it.models[-1] = replace(with_it.models[-1], log_density=fairly)
            found.append(Contender(fitted, with_it, with_it.evidence - state.evidence - fitted.overrated))
    return found


def worth(state: FitState) -> float:
    """Return the score of a model: its held-out log density, each parameter and each column of a curve paid for."""
    return state.evidence - PARAMETER_NATS * (state.parameters.size + state.curves)


def _rated(state: FitState) -> float:
    return worth(state) + sum(effect.log_prior_odds for effect in state.effects)


def _penalised_chi2(fitted: FittedCandidate) -> float:
    """Return the χ² that a candidate explains, less what it pays for its parameters and for being unlikely."""
    return fitted.gain - 2.0 * _penalty(fitted)


def _penalty(fitted: FittedCandidate) -> float:
    return PARAMETER_NATS * fitted.start.parameters - fitted.effect.log_prior_odds


def _rivals_of(chosen: Contender, contenders: Sequence[Contender]) -> tuple[CatalogueEffect, ...]:
    """Return the effects, at their best parameters, that the data cannot separate from the chosen one."""
    found = {}
    for other in contenders:
        fitted, further = other.fitted, max(other.fitted.start.parameters - chosen.fitted.start.parameters, 0)
        on_bound = further and fitted.columns.shape[1] < fitted.start.parameters
        near = other.nats - PARAMETER_NATS * further > chosen.nats - RIVAL_NATS
        if near and not on_bound and fitted.name != chosen.fitted.name:
            found[fitted.name] = fitted.effect
    return tuple(found.values())


# ---- the search -----------------------------------------------------------------------------------------------------
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
    """Return the model with every missing effect that the data can name."""
    run, first = _Run(catalogue, say), localise(start)
    state, tests = _stepped(start, first, run)
    likeliest, taken = swapped(state, run.fitted_with)
    if taken:
        say("; ".join(f"{effect.name} in place of {name}" for name, effect in taken.items()))
        for old, effect in taken.items():
            at = next(i for i, step in enumerate(run.steps) if step.name == old)
            step = replace(run.steps[at], name=effect.name, where=effect.where)
            run.steps[at] = replace(step, gap_after=likeliest.gap, rivals=())
        state, dropped = _pruned(likeliest, say)  # what stood next to another name may be superfluous next to this one
        for name in dropped:
            _forget(run, name)
        tests = localise(state)
    return Search(state, start, tuple(run.steps), tests, first)


def _stepped(state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> tuple[FitState, tuple[Disagreement, ...]]:
    for _ in range(_MOST_STEPS):
        following = _one_step(state, tests, run)
        if following is None:
            break
        state, dropped = _pruned(following, run.say)
        for name in dropped:
            _forget(run, name)
        if dropped:  # rivals were judged next to what is gone; what the plan cannot separate is determined again
            run.steps = [replace(step, rivals=()) for step in run.steps]
        tests = localise(state)
    return state, tests


def _one_step(state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> FitState | None:
    standing = significant(tests)
    screened = run.screened = screen(state, run.catalogue, run.pool, run.screened, _FITTED + len(run.refused))
    # What is significant among all that were tried, or may yet become so: a start shows only part of its gain.
    limit = (SIGNIFICANCE / max(len(screened), 1)) ** (0.5 if standing else 1.0)
    likely = (c for c in screened if chi2_beyond(max(c.gain, 1e-9), c.parameters) < limit)
    promising = [candidate for candidate in likely if candidate.effect.name not in run.refused]
    departed = [] if standing else departing(tests, state.effects)
    if not standing and not promising and not departed:
        return None
    all_fitted = (_fitted(state, candidate, run) for candidate in promising[:_FITTED])
    fitted = sorted((f for f in all_fitted if not f.effect.is_nothing()), key=lambda f: -_penalised_chi2(f))
    judged = [(f, judged_gain(state, f)) for f in fitted[:_JUDGED]]
    contenders = contenders_of(state, [f for f, nats in judged if nats >= NAMED_NATS - RIVAL_NATS])
    shown = sorted((entry for entry in contenders if entry.is_shown), key=lambda entry: -entry.score)
    looser = loosened(state, None if standing else departed)
    gained = -np.inf if looser is None else worth(looser) - worth(state) - RIVAL_NATS
    for chosen in shown[:1]:
        if _convinces(state, chosen, standing) and chosen.score >= gained:
            run.fitted_with[chosen.fitted.name] = tuple(f.effect for f in fitted if f.name != chosen.fitted.name)
            return _named(state, chosen, contenders, run)
    if looser is not None:
        return _taken(state, looser, run)
    return _unnamed(state, standing, judged, run) if standing else None


def _fitted(state: FitState, candidate: Candidate, run: _Run) -> FittedCandidate:
    key = (candidate.effect.name, candidate.flexible)
    found = fit_candidate(state, replace(candidate, others=(*candidate.others, *run.forms.get(key, ()))))
    run.forms[key] = found.forms
    return found


def _taken(state: FitState, looser: FitState, run: _Run) -> FitState:
    newest, nats, gap = looser.effects[-1], looser.evidence - state.evidence, looser.gap
    at = next(i for i, step in enumerate(run.steps) if step.name == newest.name)
    old = run.steps[at]
    rivals = _by_laws_of_theirs(looser, run.fitted_with.get(newest.name, ())) if isinstance(newest, FreeLaw) else ()
    run.steps[at] = replace(old, gain_nats=old.gain_nats + nats, gap_after=gap, rivals=(*old.rivals, *rivals))
    run.say(f"{newest.name} in a more flexible form: {nats:.1f} nats, gap {state.gap:.3f} → {gap:.3f}")
    return looser


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
    effect, gap = chosen.fitted.effect, chosen.state.gap
    again = next((i for i, step in enumerate(run.steps) if step.name == effect.name), None)
    if again is None:
        rivals = _rivals_of(chosen, contenders)
        run.steps.append(Step(effect.name, effect.where, chosen.nats, state.gap, gap, rivals))
    else:
        old = run.steps[again]
        run.steps[again] = replace(old, gain_nats=old.gain_nats + chosen.nats, gap_after=gap)
    run.say(f"{effect.name}: {chosen.nats:.1f} nats, gap {state.gap:.3f} → {gap:.3f}")
    return chosen.state


def _unnamed(
    state: FitState, standing: tuple[Disagreement, ...], judged: list[tuple[FittedCandidate, float]], run: _Run
) -> FitState | None:
    tried = {old.name for old in state.terms} | run.refused
    fresh = [t for t in standing if smooth_term(state, t).name not in tried]
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


def _pruned(state: FitState, say: Callable[[str], None]) -> tuple[FitState, list[str]]:
    """Drop earlier effects and unnamed terms that the newest made superfluous."""
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
        others: What was fitted with each name, the best first.
    """
    taken = dict[str, CatalogueEffect]()
    for effect in state.effects if len(state.effects) > 1 else ():
        present = {other.name for other in state.effects}
        starts = [other for other in others.get(effect.name, ()) if other.name not in present][:_SWAPPED]
        rest = with_effects(state, [other for other in state.effects if other.name != effect.name])
        fitted = [fit_candidate(rest, Candidate(start, 0.0, len(start.free()) or 1)) for start in starts]
        for entry in contenders_of(rest, sorted(fitted, key=_penalised_chi2)[-1:]):
            if _rated(entry.state) > _rated(state) and not is_misfit(entry.state):  # else it takes up others' residual
                state, taken[effect.name] = entry.state, entry.fitted.effect
    return state, taken


def loosened(state: FitState, only: Sequence[str] | None = None) -> FitState | None:
    """Return the model in which one effect, the last then, took a more flexible form; None where none is worth it.

    Each further parameter must be paid for, and the whole be as far beyond chance as a further name.

    Args:
        only: Names of the effects that leave structure in their own place, where these alone are asked and the
            tests of that place are what is beyond chance; by default all effects.
    """
    needed = NAMED_NATS if only is None else 0.0
    forms = sorted(_forms_of_promise(state, only), key=lambda entry: -entry[0])[:_REFITTED]
    fitted = (_with_form(state, index, form) for nats, index, form in forms if nats >= needed)
    best = max((one for one in fitted if one is not None), key=worth, default=state)
    return best if best is not state and worth(best) - worth(state) >= needed else None


def _by_laws_of_theirs(looser: FitState, others: Sequence[CatalogueEffect]) -> tuple[CatalogueEffect, ...]:
    """Return other entries, each by a free law, that leave nothing in the place of the newest effect either."""
    rest, found = with_effects(looser, looser.effects[:-1]), list[CatalogueEffect]()
    present, place = {effect.name for effect in looser.effects}, len(rest.effects)
    for other in [other for other in others if other.name not in present][:_SWAPPED]:
        forms = free_forms(rest, other)
        best = max(forms, key=lambda form: _promise(rest, (*rest.effects, form), place) - _cost(form), default=None)
        fitted = None if best is None else _with_form(rest, place, best)
        if fitted is not None and not is_misfit(fitted):
            found.append(fitted.effects[-1])
    return tuple(found)


def _cost(effect: CatalogueEffect) -> float:
    return PARAMETER_NATS * len(effect.free())


def _promise(state: FitState, effects: Sequence[CatalogueEffect], index: int) -> float:
    """Return the nats that one of some effects, instead of the model's, would bring if it acted linearly."""
    followed = state.fit.followed(directions_of(state, effects, index))
    return state.fit.score(slice(0, state.comparison.size), followed)[0] / 2.0


def _forms_of_promise(state: FitState, only: Sequence[str] | None) -> Iterator[tuple[float, int, CatalogueEffect]]:
    """Yield nats that each form would bring beyond its cost, the place of its effect, and the form."""
    for index, effect in enumerate(state.effects):
        if only is not None and effect.name not in only:
            continue
        free = free_forms(state, effect) if is_misfit(state) else ()  # the law of what hardly shows can be any
        for form in (*effect.loosened(state.model.context), *free):
            effects = [form if place == index else other for place, other in enumerate(state.effects)]
            yield _promise(state, effects, index) - _cost(form) + _cost(effect), index, form


def _with_form(state: FitState, index: int, form: CatalogueEffect) -> FitState | None:
    others = [effect for place, effect in enumerate(state.effects) if place != index]
    try:
        fitted = converged_fit(coarse_fit(with_effects(state, [*others, form])))
    except (np.linalg.LinAlgError, ConfigurationError):  # no covariance, or parameters that are no numbers
        return None
    return None if fitted.effects[-1] == form else fitted  # what does not move is the plain form


# ---- looser forms and free laws -------------------------------------------------------------------------------------
_KNOTS: Final = (5, 9)
_OF_TWO: Final = 6  # of the first of two covariates
_LEVELS: Final = 6  # of a covariate, each of which is a knot


def free_forms(state: FitState, effect: CatalogueEffect) -> tuple[FreeLaw, ...]:
    """Return an effect with a free law: along each of its covariates, and along two together.

    Args:
        state: The model, which gives the signals in front of the effect.
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
