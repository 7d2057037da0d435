"""Names missing effects one after the other until nothing structured is left."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from radiometer.reconciliation.fit.candidate_fit import (
    Candidate,
    FittedCandidate,
    curve_gain,
    fit_candidate,
    judged_gain,
)
from radiometer.reconciliation.fit.covariance import is_far, is_misfit, scatter_of
from radiometer.reconciliation.fit.descent import refit
from radiometer.reconciliation.fit.full_fit import FullFits, UnfitError, contenders_of
from radiometer.reconciliation.fit.state import FitState, reweighted, with_terms
from radiometer.reconciliation.search.localise import Disagreement, departing, localise, significant, smooth_term
from radiometer.reconciliation.search.moves import (
    Loosened,
    LooserForms,
    better,
    by_a_free_law,
    fit_swapped,
    in_place_of_all,
    pruned,
    simpler,
)
from radiometer.reconciliation.search.outcome import Search, Step
from radiometer.reconciliation.search.score import (
    by_itself,
    is_shown,
    likeliest,
    log_chance,
    penalised_chi2,
    rated,
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
    NEAR_SHARE,
    PARAMETER_NATS,
    SIGNIFICANCE,
    SMOOTH_SHARE,
)
from simulators.effects.base import DIGITAL_NUMBER, EXPOSURE, IRRADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Offset, Scaling
from simulators.effects.context import ExposureContext

# ---- plain trends -------------------------------------------------------------------------------------------------
# What no more freedom than an entry's explains better is not that entry. Trends are fitted like effects, in all
# statistics at once, but belong to no catalogue: where one of them wins, the disagreement stays unnamed. A trend whose
# `where` is empty answers for every covariate.


@dataclass(frozen=True)
class ConstantTrend(Offset):
    """Adds the same to every digital number: y' = y + b.

    Source: the constant term of any trend.
    """

    name = "constant_trend"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = ""
    block = "mean"
    trials = ({"offset_dn": 1.0}, {"offset_dn": -1.0})
    fitted = ("offset_dn",)
    offset_dn: float = parameter(0.0, "DN", -1.0, 1.0, source="free", of_full_scale=True)

    def offset(self, context: ExposureContext) -> float:
        """Return b in DN."""
        return self.offset_dn


@dataclass(frozen=True)
class RadialTrend(Scaling):
    """Scales light by a polynomial of the field radius: E' = E·(1 + a₂·ρ² + a₄·ρ⁴).

    Source: the first even terms of any curve about the lens's axis.
    """

    name = "radial_trend"
    stage = Stage.OPTICS
    unit_in = IRRADIANCE
    unit_out = IRRADIANCE
    where = ""
    block = "slope"
    trials = ({"a2": -0.03}, {"a2": 0.03})
    fitted = ("a2", "a4")
    a2: float = parameter(0.0, "1", -1.0, 1.0, source="free")
    a4: float = parameter(0.0, "1", -1.0, 1.0, source="free")

    def factor(self, context: ExposureContext) -> Any:
        """Return the polynomial."""
        rho2 = np.square(context.geometry.field_radius())
        return np.maximum(1.0 + self.a2 * rho2 + self.a4 * rho2**2, 0.01)


@dataclass(frozen=True)
class ExposureTrend(Scaling):
    """Scales light by a straight line along the logarithm of the exposure time: H' = H·(1 + b·ln(t/1 ms)).

    Source: the first term of any slow curve along the exposures.
    """

    name = "exposure_trend"
    stage = Stage.SHUTTER
    unit_in = EXPOSURE
    unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    trials = ({"b": 0.005}, {"b": -0.005})
    fitted = ("b",)
    b: float = parameter(0.0, "1", -0.05, 0.05, source="free")

    def factor(self, context: ExposureContext) -> Any:
        """Return the line."""
        return np.maximum(1.0 + self.b * np.log(np.asarray(context.settings.exposure_s) / 1e-3), 0.01)


TRENDS: Final[tuple[type[CatalogueEffect], ...]] = (ConstantTrend, RadialTrend, ExposureTrend)


_FITTED: Final = 7  # candidates that are fitted in each step
_JUDGED: Final = 4  # of them, those that are judged on held-out settings
_SMOOTHS_TRIED: Final = 4
_NEAR_FORM: Final = 0.5
_LITTLE_PROMISE: Final = 0.05  # of what a further effect brings: forms came to eleven times their promise at most
_AFTER_A_LAW: Final = 3  # further steps next to one form or law in place of all
_OTHER_WAYS: Final = 2  # that are gone where the first leaves doubts


@dataclass(slots=True)
class _Run:
    catalogue: Mapping[str, type[CatalogueEffect]]
    say: Callable[[str], None]
    steps: list[Step] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    pool: StartPool = field(default_factory=StartPool)
    first: list[CatalogueEffect] = field(default_factory=list)  # what fitted best before anything was named
    turns: list[_Turn] = field(default_factory=list)
    screened: list[Candidate] = field(default_factory=list)  # next to the model before
    forms: dict[tuple[str, bool], tuple[CatalogueEffect, ...]] = field(default_factory=dict)  # as they were fitted then
    barred: str = ""  # a name that this step may not give
    fitted_with: dict[str, tuple[CatalogueEffect, ...]] = field(default_factory=dict)  # what was fitted with each name


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """A step at which another entry was nearly chosen."""

    state: FitState  # the model before it
    tests: tuple[Disagreement, ...]  # its tests
    chosen: str  # the name that was given
    lead: float  # by what share of its score it was ahead of the next in the same statistic
    steps: tuple[Step, ...]  # the steps before
    refused: frozenset[str]  # what had been refused before


def search(
    start: FitState,
    catalogue: Mapping[str, type[CatalogueEffect]],
    say: Callable[[str], None] = lambda line: None,
    is_doubted: Callable[[Search], bool] = lambda found: False,
) -> Search:
    """Return the model with every missing effect that the data can name.

    Args:
        start: The ideal camera fitted.
        catalogue: Entries to try, by name.
        say: Told what happens, line by line.
        is_doubted: Tells whether what was found is provisional though nothing is left, so that the search is taken up
            again from where another entry was nearly chosen.
    """
    run, first = _Run(catalogue, say), localise(start)
    found = _to_its_end(start, start, first, run)
    for turn in sorted(run.turns, key=lambda turn: turn.lead)[:_OTHER_WAYS]:
        if not is_doubted(found):
            break
        say(f"another way: not {turn.chosen} after {', '.join(step.name for step in turn.steps) or 'nothing'}")
        again = _Run(catalogue, say, [*turn.steps], {*turn.refused}, run.pool, run.first)
        other = _to_its_end(start, turn.state, turn.tests, again, barred=turn.chosen)
        run.fitted_with |= again.fitted_with
        if rated(other.state) > rated(found.state) + NAMED_NATS:
            say(f"better by {rated(other.state) - rated(found.state):.1f} nats: gap {other.state.gap:.3f}")
            found = other
    fit_swapped(found.state, run.fitted_with)
    return replace(found, first_tests=first)


def _to_its_end(
    start: FitState, state: FitState, tests: tuple[Disagreement, ...], run: _Run, barred: str = ""
) -> Search:
    """Return the outcome of a search from a model on, where one name may not be given at once."""
    state, tests = _stepped(state, tests, run, MOST_STEPS, barred)
    for change in (_as_one, _refined):
        changed = change(start, state, tests, run)
        if changed is None:
            continue
        state, tests, steps = changed, localise(changed), list(run.steps)
        further, later = _stepped(state, tests, run, _AFTER_A_LAW)
        if worth(further) > worth(state):
            state, tests = further, later
        else:
            run.steps = steps
    return Search(state, start, tuple(run.steps), significant(tests), tests, ())


def _stepped(
    state: FitState, tests: tuple[Disagreement, ...], run: _Run, most: int, barred: str = ""
) -> tuple[FitState, tuple[Disagreement, ...]]:
    """Return the model after up to so many steps, of which the first may not give one name, and its tests."""
    for step in range(most):
        run.barred = barred if step == 0 else ""
        try:
            following = _one_step(state, tests, run)
        except UnfitError as unfit:
            run.refused.add(str(unfit))
            continue
        if following is None and (following := _exchanged(state, tests, run)) is None:
            break
        state, dropped = pruned(following, run.say)
        for name in dropped:
            _forget(run, name)
        if dropped:  # rivals were judged next to what is gone; what the plan cannot separate is determined again
            run.steps = [replace(step, rivals=()) for step in run.steps]
        state = _joined(state, run)
        tests = localise(state)
    return state, tests


def _as_one(start: FitState, state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> FitState | None:
    """Return the model with one entry in a looser form in place of several names, where it predicts better."""
    found = in_place_of_all(start, state, run.catalogue)
    if found is None:
        return None
    (effect,) = found.effects
    run.say(f"{effect.name} in a looser form in place of all: gap {state.gap:.3f} → {found.gap:.3f}")
    run.steps = [Step(effect.name, effect.where, found.evidence - start.evidence, start.gap, found.gap)]
    return found


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
    promising = [candidate for candidate in promising if candidate.effect.name not in {*run.refused, run.barred}]
    departed = [] if standing else departing(tests, state.effects)
    if not standing and not promising and not departed:
        return None
    fitted = sorted((_fitted(state, c, run) for c in promising[:_FITTED]), key=lambda f: -penalised_chi2(f))
    run.first = run.first or [candidate.effect for candidate in fitted]
    judged = [(f, judged_gain(state, f)) for f in fitted[:_JUDGED]]
    far = is_far(state)
    shown = [entry for entry in judged if is_shown(*entry, limit, later=bool(state.effects), far=far)]
    looser = LooserForms.of(state, None if standing else departed)
    fits, steps, refused = FullFits(state), tuple(run.steps), frozenset(run.refused)
    while shown:
        contenders = contenders_of(fits, shown)
        chosen = likeliest(contenders)
        if chosen is None:
            break
        if contenders is not shown:
            chosen = by_itself(contenders, shown, scatter_of(fits.included(chosen[0].effect, far=True)))
        plain = _plain_leads(fits, chosen)
        if not _convinces(state, chosen, standing, plain) or _is_likelier(fits, looser, chosen):
            break
        others = judged if contenders is shown else contenders
        outperformed = any(_is_plainer(kind, chosen[0]) and lead > 0.0 for kind, lead in plain.items())
        outperformed |= any(_outperforms(other, chosen) for other in others)
        following = _named(fits, chosen, others, run, outperformed=outperformed)
        if following is not None:
            run.fitted_with[chosen[0].name] = tuple(f.effect for f in fitted if f.name != chosen[0].name)
            if (lead := _lead(chosen, others)) < NEAR_SHARE:
                run.turns.append(_Turn(state, tests, chosen[0].name, lead, steps, refused))
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


def _convinces(
    state: FitState,
    chosen: tuple[FittedCandidate, float],
    standing: tuple[Disagreement, ...],
    plain: Mapping[type[CatalogueEffect], float],
) -> bool:
    fitted, nats = chosen
    if any(lead > (0.0 if _is_constant(kind, fitted) else NAMED_NATS) for kind, lead in plain.items()):
        return False
    same = [test for test in standing if test.family == fitted.effect.block]
    if not same:
        return True
    smooth = _smooth_gain(state, same[0])
    return nats >= SMOOTH_SHARE * smooth or nats >= smooth - NAMED_NATS


def _plain_leads(fits: FullFits, chosen: tuple[FittedCandidate, float]) -> dict[type[CatalogueEffect], float]:
    """Return by how many nats each plain trend of no more freedom predicts better than the chosen effect."""
    effect = chosen[0].effect
    return {
        kind: _plain_lead(fits, kind, chosen)
        for kind in TRENDS
        if kind.block == effect.block and kind.where in ("", effect.where) and len(kind.fitted) <= chosen[0].parameters
    }


def _plain_lead(fits: FullFits, kind: type[CatalogueEffect], chosen: tuple[FittedCandidate, float]) -> float:
    state = fits.state
    starts = kind.starts(state.model.context)
    plain = fit_candidate(state, Candidate(starts[0], 0.0, len(kind.fitted), others=starts[1:]))
    (_, named), (_, trend) = contenders_of(fits, [chosen, (plain, judged_gain(state, plain))], fewest=2)
    return trend + PARAMETER_NATS * (chosen[0].parameters - plain.parameters) - named


def _is_constant(kind: type[CatalogueEffect], fitted: FittedCandidate) -> bool:
    """Return whether a trend is a mere constant, of fewer parameters than an effect that depends on some setting."""
    return not kind.where and len(kind.fitted) == 1 < fitted.parameters


def _is_plainer(kind: type[CatalogueEffect], fitted: FittedCandidate) -> bool:
    """Return whether a trend follows an effect's very covariate with fewer parameters than it."""
    return kind.where == fitted.effect.where and len(kind.fitted) < fitted.parameters


def _outperforms(other: tuple[FittedCandidate, float], chosen: tuple[FittedCandidate, float]) -> bool:
    """Return whether another entry predicts better, each parameter paid for, its prior probability left out."""
    mine, others = (nats - PARAMETER_NATS * fitted.parameters for fitted, nats in (chosen, other))
    return other[0].name != chosen[0].name and others > mine + PARAMETER_NATS


def _lead(chosen: tuple[FittedCandidate, float], others: Sequence[tuple[FittedCandidate, float]]) -> float:
    """Return by what share of its score a name is ahead of the next entry that shows in the same statistic."""
    best, (mine, _) = score(chosen), chosen
    same = (
        score(other) for other in others if other[0].name != mine.name and other[0].effect.block == mine.effect.block
    )
    return 1.0 - max(same, default=-np.inf) / best if best > 0.0 else np.inf


def _smooth_gain(state: FitState, test: Disagreement) -> float:
    term = smooth_term(state, test)
    columns = state.pad(term.build(state.comparison, state.prediction, state.sensitivity))
    return curve_gain(state, state.fit.followed(columns))


def _named(
    fits: FullFits,
    chosen: tuple[FittedCandidate, float],
    contenders: list[tuple[FittedCandidate, float]],
    run: _Run,
    *,
    outperformed: bool,
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
        run.steps.append(Step(fitted.name, where, nats, gap_before, following.gap, rivals, outperformed=outperformed))
    else:
        old = run.steps[again]
        run.steps[again] = replace(old, gain_nats=old.gain_nats + nats, gap_after=following.gap)
    run.say(f"{fitted.name}: {nats:.1f} nats, gap {gap_before:.3f} → {following.gap:.3f}")
    return following


def _joined(state: FitState, run: _Run) -> FitState:
    """Return the model with one entry in place of names that it may explain."""
    found = simpler(state, run.catalogue)
    return state if found is None else _in_place(state, found, found[1].stands_for, run)


def _exchanged(state: FitState, tests: tuple[Disagreement, ...], run: _Run) -> FitState | None:
    """Return the model with another name in place of one that leaves structure after later ones, if any."""
    for name in departing(tests, state.effects) if len(state.effects) > 1 else ():
        found = better(state, name, run.catalogue, run.pool)
        if found is not None:
            run.refused.add(name)
            return _in_place(state, found, (name,), run)
    return None


def _in_place(state: FitState, found: tuple[FitState, CatalogueEffect], names: Sequence[str], run: _Run) -> FitState:
    changed, effect = found
    old = [step for step in run.steps if step.name in names]
    nats = sum(step.gain_nats for step in old) + changed.evidence - state.evidence
    run.steps[run.steps.index(old[0])] = Step(effect.name, effect.where, nats, old[0].gap_before, changed.gap)
    run.steps = [step for step in run.steps if step not in old]
    run.say(f"{effect.name} in place of {' and '.join(names)}: gap {state.gap:.3f} → {changed.gap:.3f}")
    return changed


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
