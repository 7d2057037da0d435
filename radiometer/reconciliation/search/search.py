"""Names missing effects one after the other until nothing structured is left."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from radiometer.reconciliation.fit.candidate_fit import (
    Candidate,
    FittedCandidate,
    curve_gain,
    fit_candidate,
    judged_gain,
)
from radiometer.reconciliation.fit.descent import is_misfit, refit, scatter_of
from radiometer.reconciliation.fit.full_fit import FullFits, UnfitError, contenders_of
from radiometer.reconciliation.fit.state import FitState, reweighted, with_terms
from radiometer.reconciliation.search.localise import Disagreement, departing, localise, significant, smooth_term
from radiometer.reconciliation.search.moves import (
    Loosened,
    LooserForms,
    by_a_free_law,
    fit_swapped,
    pruned,
)
from radiometer.reconciliation.search.outcome import (
    Search,
    Step,
    is_shown,
    log_chance,
    penalised_chi2,
    rivals_of,
    score,
    worth,
)
from radiometer.reconciliation.search.screening import Before, StartPool, screen
from radiometer.reconciliation.thresholds import (
    FLEXIBLE_NATS,
    HUGE_NATS,
    KEPT_NATS,
    MOST_STEPS,
    NAMED_NATS,
    PARAMETER_NATS,
    SIGNIFICANCE,
    SMOOTH_SHARE,
)
from simulators.effects.catalogue import CatalogueEffect

_FITTED: Final = 7  # candidates that are fitted in each step
_JUDGED: Final = 4  # of them, those that are judged on held-out settings
_SMOOTHS_TRIED: Final = 4
_NEAR_FORM: Final = 0.5
_LITTLE_PROMISE: Final = 0.05  # of what a further effect brings: forms came to eleven times their promise at most
_AFTER_A_LAW: Final = 3  # further steps next to a free law


@dataclass(slots=True)
class _Run:
    catalogue: Mapping[str, type[CatalogueEffect]]
    say: Callable[[str], None]
    steps: list[Step] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    pool: StartPool = field(default_factory=StartPool)
    first: list[CatalogueEffect] = field(default_factory=list)  # what fitted best before anything was named
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
    state, tests = _stepped(start, first, run, MOST_STEPS)
    changed = _refined(start, state, tests, run)
    if changed is not None:
        state, tests, steps = changed, localise(changed), list(run.steps)
        further, later = _stepped(state, tests, run, _AFTER_A_LAW)
        if worth(further) > worth(state):
            state, tests = further, later
        else:
            run.steps = steps
    fit_swapped(state, run.fitted_with)
    return Search(state, start, tuple(run.steps), significant(tests), tests, first)


def _stepped(
    state: FitState, tests: tuple[Disagreement, ...], run: _Run, most: int
) -> tuple[FitState, tuple[Disagreement, ...]]:
    """Return the model after up to so many steps, and its tests."""
    for _ in range(most):
        try:
            following = _one_step(state, tests, run)
        except UnfitError as unfit:
            run.refused.add(str(unfit))
            continue
        if following is None:
            break
        state, dropped = pruned(following, run.say)
        for name in dropped:
            _forget(run, name)
        if dropped:  # rivals were judged next to what is gone; what the plan cannot separate is determined again
            run.steps = [replace(step, rivals=()) for step in run.steps]
        tests = localise(state)
    return state, tests


def _refined(start: FitState, state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> FitState | None:
    """Return the model with a free law for one name, where structure stays and it does better than what was found."""
    unnamed = any(step.name == "unnamed" for step in run.steps)
    stays = unnamed or significant(tests) or is_misfit(state) or departing(tests, state.effects)
    if not (stays and is_misfit(start)):  # the law of what hardly shows can be any
        return None
    found = by_a_free_law(start, state, run.first)
    if found is None:
        return None
    run.say(f"{found.name} by a free law: gap {state.gap:.3f} → {found.state.gap:.3f}")
    old = {step.name: step for step in run.steps}
    refined, dropped = pruned(found.state, run.say)
    run.steps = []
    for effect in sorted(refined.effects, key=lambda effect: effect.name == found.name):
        step = Step(effect.name, effect.where, found.nats, found.without.gap, refined.gap, found.rivals)
        run.steps.append(step if effect.name == found.name else old[effect.name])
    run.refused |= set(dropped)
    return refined


def _one_step(state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> FitState | None:
    standing = significant(tests)
    screened = run.screened = screen(state, run.catalogue, run.pool, Before(run.screened, _FITTED + len(run.refused)))
    limit = float(np.log(SIGNIFICANCE / max(len(screened), 1)))
    promising = _promising(screened, limit, standing)
    promising = [candidate for candidate in promising if candidate.effect.name not in run.refused]
    departed = [] if standing else departing(tests, state.effects)
    if not standing and not promising and not departed:
        return None
    fitted = sorted((_fitted(state, c, run) for c in promising[:_FITTED]), key=lambda f: -penalised_chi2(f))
    run.first = run.first or [candidate.effect for candidate in fitted]
    judged = [(f, judged_gain(state, f)) for f in fitted[:_JUDGED]]
    shown = [entry for entry in judged if is_shown(*entry)]
    looser = LooserForms.of(state, None if standing else departed)
    fits = FullFits(state)
    while shown:
        contenders = contenders_of(fits, shown)
        chosen = max(contenders, key=score)
        if not _convinces(state, chosen, standing) or _is_likelier(fits, looser, chosen):
            break
        others = judged if contenders is shown else contenders
        following = _named(fits, chosen, others, run)
        if following is not None:
            run.fitted_with[chosen[0].name] = tuple(f.effect for f in fitted if f.name != chosen[0].name)
            return following
        shown = [entry for entry in shown if entry[0].name != chosen[0].name]
    if looser.best is not None:
        return _taken(state, looser.best, run)
    return _unnamed(state, standing, judged, run) if standing else None


def _fitted(state: FitState, candidate: Candidate, run: _Run) -> FittedCandidate:
    """Return a candidate fitted; it begins from its fit with the model before, too."""
    key = (candidate.effect.name, candidate.flexible)
    found = fit_candidate(state, replace(candidate, others=(*candidate.others, *run.forms.get(key, ()))))
    run.forms[key] = found.forms
    return found


def _is_likelier(fits: FullFits, looser: LooserForms, chosen: tuple[FittedCandidate, float]) -> bool:
    """Return whether another form of an effect that is there predicts better than a further effect.

    The form is fitted in full, unless it promises too little; where the two are near, the further effect is too, before
    they are compared.
    """
    if looser.promise < _LITTLE_PROMISE * score(chosen) or looser.best is None:
        return False
    form = looser.best.nats - PARAMETER_NATS * looser.best.further - FLEXIBLE_NATS
    if form > score(chosen) or form < _NEAR_FORM * score(chosen):
        return form > score(chosen)
    fitted = fits.included(chosen[0].effect, far=False)
    return form > score((chosen[0], fitted.evidence - fits.state.evidence))


def _taken(state: FitState, looser: Loosened, run: _Run) -> FitState:
    at = next(i for i, step in enumerate(run.steps) if step.name == looser.name)
    gap = looser.state.gap
    run.steps[at] = replace(run.steps[at], gain_nats=run.steps[at].gain_nats + looser.nats, gap_after=gap)
    run.say(f"{looser.name} in a more flexible form: {looser.nats:.1f} nats, gap {state.gap:.3f} → {gap:.3f}")
    return looser.state


def _promising(candidates: list[Candidate], limit: float, standing: tuple[Disagreement, ...]) -> list[Candidate]:
    """Return candidates whose gain is significant among all that were tried, or may yet become so."""
    slack = 0.5 if standing else 1.0  # a start far from the best parameters shows only part of its gain
    return [c for c in candidates if log_chance(c.gain, c.parameters) < slack * limit]


def _convinces(state: FitState, chosen: tuple[FittedCandidate, float], standing: tuple[Disagreement, ...]) -> bool:
    fitted, nats = chosen
    same = [test for test in standing if test.family == fitted.effect.block]
    if not same:
        return True
    smooth = _smooth_gain(state, same[0])
    return nats >= SMOOTH_SHARE * smooth or nats >= smooth - NAMED_NATS


def _smooth_gain(state: FitState, test: Disagreement) -> float:
    term = smooth_term(state, test)
    columns = state.pad(term.build(state.comparison, state.prediction, state.sensitivity))
    return curve_gain(state, state.fit.followed(columns))


def _named(
    fits: FullFits,
    chosen: tuple[FittedCandidate, float],
    contenders: list[tuple[FittedCandidate, float]],
    run: _Run,
) -> FitState | None:
    """Return the model with the chosen effect; None where, all refitted, it does not predict better after all.

    Contenders are judged as the chosen one is.
    """
    (fitted, nats), state = chosen, fits.state
    following = fits.included(fitted.effect, far=nats > HUGE_NATS)
    brought = following.evidence - state.evidence
    if brought < KEPT_NATS or brought < NAMED_NATS * scatter_of(following):
        run.refused.add(fitted.name)
        return None
    rivals = rivals_of(chosen, contenders)
    for rival in rivals:
        fits.try_out(rival, far=nats > HUGE_NATS)
    gap_before = state.gap
    again = next((i for i, step in enumerate(run.steps) if step.name == fitted.name), None)
    if again is None:
        where = fitted.effect.where
        run.steps.append(Step(fitted.name, where, nats, gap_before, following.gap, rivals))
    else:
        old = run.steps[again]
        run.steps[again] = replace(old, gain_nats=old.gain_nats + nats, gap_after=following.gap)
    run.say(f"{fitted.name}: {nats:.1f} nats, gap {gap_before:.3f} → {following.gap:.3f}")
    return following


def _unnamed(
    state: FitState,
    standing: tuple[Disagreement, ...],
    judged: list[tuple[FittedCandidate, float]],
    run: _Run,
) -> FitState | None:
    tried = {old.name for old in state.terms} | run.refused
    fresh = [t for t in standing if smooth_term(state, t).name not in tried]
    rated = ((test, _smooth_gain(state, test)) for test in fresh[:_SMOOTHS_TRIED])
    worthy = ((test, nats) for test, nats in rated if nats > PARAMETER_NATS * scatter_of(state))
    tried_out = ((test, nats, _with_curve(state, test)) for test, nats in worthy)
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


def _with_curve(state: FitState, test: Disagreement) -> FitState:
    """Return the model with a smooth term that takes up a disagreement, all fitted anew."""
    old = tuple(term for term in state.terms if term.is_smooth)
    return refit(reweighted(refit(with_terms(state, (*old, smooth_term(state, test)))))).recorded()


def _forget(run: _Run, name: str) -> None:
    where = name.split(" | ")
    run.refused.add(name)
    for step in list(run.steps):
        if step.name == name or (step.name == "unnamed" and len(where) > 1 and step.where == where[1]):
            run.steps.remove(step)
            break
