"""Finds the law: stage, covariates and formula by what they predict of held-out settings, each parameter paid for.

First all laws of the grammar are tested on the tiles' means, slopes and first frames, linearised about the starting
camera with all nuisances following. The best of each kind are then fitted to all statistics as effects, and judged as
names are. Source of the score: docs/decisions/0011.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError, MeasurementError
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.fit.candidate_fit import Candidate, FittedCandidate, fit_candidate, judged_gain
from radiometer.reconciliation.fit.covariance import fitted_parameters, is_far
from radiometer.reconciliation.fit.full_fit import FullFits, UnfitError, contenders_of, included
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.propose.first_look import Screened, known_values, screened
from radiometer.reconciliation.propose.grammar import PLACES, finer, terms_of
from radiometer.reconciliation.propose.law import Law, effect_of, round_to
from radiometer.reconciliation.propose.proposal import Proposal, Rival
from radiometer.reconciliation.search.free_laws import free_forms
from radiometer.reconciliation.search.score import worth
from radiometer.reconciliation.search.screening import best_start
from radiometer.reconciliation.thresholds import NAMED_NATS, PARAMETER_NATS, RIVAL_NATS
from simulators.chain.law_stages import LINKS
from simulators.effects.catalogue import CatalogueEffect

_NOISES: Final = {"1": (0.002, 0.01), "DN": (0.5, 3.0)}  # standard deviations that laws of noise start from, by unit
_OF_NOISE: Final = ("power", "step")  # forms that are nowhere below 0
_FITTED: Final = 16  # laws that are fitted to all statistics
_JUDGED: Final = 9
_MULTIPLIED: Final = 5  # laws of one term that are multiplied by another
_ALONE: Final = ("well", "range")  # what goes with the signal goes with nothing else, nor what comes back in turns
_PLAIN: Final = ("digital", "optics")  # of two that no setting separates: what no gain amplifies, what scales light
_OF_A_PLACE: Final = {*PLACES, "column_light"}
_SECOND: Final = ("ramp", "power", "step", "decay", "bow")
_OF_A_KIND: Final = 2  # laws of one formula at different stages that are fitted, beyond the best
_NEAR: Final = 0.5  # share of the best start's gain from which others of its kind are tried: means alone alias waves
_STARTS: Final = 10
_PLACES: Final = 60  # where a law of a sharp place starts: the means alone hardly tell rows of one tile apart
_REFINED: Final = (("step", "border"), ("step",))  # in two turns: a border is found to half a pixel in the first
_FINER: Final = 6  # laws of a sharp place that are refined

Say = Callable[[str], None]


@on_one_blas_thread
def propose_law(
    state: FitState, say: Say = lambda line: None, along: Collection[str] = (), most: float = np.inf
) -> Proposal | None:
    """Return the law that explains best what a starting camera lacks; None where none is beyond chance.

    Args:
        state: The starting camera fitted, without any effect that was named.
        say: Told what happens, line by line.
        along: Covariates to which laws are confined, of one term then; by default all, and products of two terms.
        most: χ² under the weights of the starting camera that a law may leave at best.
    """
    singles = screened(state, (law for law in _singles(state) if not along or set(law.covariates) <= set(along)))
    for forms in _REFINED:
        singles += screened(state, _finer(state, singles, forms))
    say(f"{len(singles)} laws of one term looked at")
    plain = {_formula(entry.law): entry.score for entry in sorted(singles, key=lambda entry: entry.score)}
    products = [
        entry
        for entry in (screened(state, _products(state, singles)) if not along else ())
        if entry.score > plain.get(_formula(entry.law)[:1], 0.0) + NAMED_NATS
    ]
    fits = FullFits(state, most)
    judged = _judged(fits, _chosen([*singles, *products, *_noises(state, along)]), say)
    if not judged:
        return None
    best = _without_its_second(fits, _plainest(judged), judged)
    if _score(best) < NAMED_NATS:
        return None
    law, fitted, nats = best
    try:
        after = fits.included(fitted.effect, far=True)
    except UnfitError:
        return None
    effect = next(e for e in after.effects if e.name == law.name)
    law = law.with_parameters(effect.values())
    rivals = tuple(
        Rival(other.name, LINKS[other.link].stage, other.covariates, round(_score(best) - _score(entry), 1))
        for entry in sorted(judged, key=lambda entry: -_score(entry))
        if (other := entry[0]) is not best[0] and _score(best) - _score(entry) < RIVAL_NATS and not _holds(other, law)
    )
    parameters = fitted_parameters(after)[law.name]
    return Proposal(law, float(effect.values()[law.amplitude]), parameters, nats, state, after, rivals)


# ---- which laws are looked at ------------------------------------------------------------------------------


def _singles(state: FitState) -> Iterator[Law]:
    known = known_values(state)
    terms = {name: tuple(terms_of(name, known)) for name in known}
    for link in (link for link in LINKS.values() if not link.is_noise):
        if "f_number" in link.goes_with and "f_number" not in known:
            continue  # it is light past the lens then
        for name in link.covariates:
            for term in terms.get(name, ()):
                from_zero = (
                    term.form in ("line", "arch") and link.unit == "1"
                )  # the responsivity is free next to a factor
                if not from_zero and all(covariate in known for covariate in term.covariates):
                    yield Law(link.key, (term,))


def _noises(state: FitState, along: Collection[str]) -> list[Screened]:
    """Return the laws of noise with the χ² that each would explain, the likeliest start of each alone."""
    known, found = known_values(state), list[Screened]()
    for link in (link for link in LINKS.values() if link.is_noise):
        terms = [term for name in link.covariates if name in known for term in terms_of(name, known)]
        laws = [Law(link.key, (term,)) for term in terms if term.form in _OF_NOISE]
        for law in [*([Law(link.key)] if link.goes_with else []), *laws]:
            if along and not {*law.covariates, *link.goes_with} <= set(along):
                continue
            start = best_start(state, [effect_of(law, size) for size in _NOISES[link.unit]])
            if start is not None:
                found.append(Screened(law, float(start.effect.values()[law.amplitude]), start.gain))
    return found


def _finer(state: FitState, singles: Sequence[Screened], forms: Collection[str]) -> Iterator[Law]:
    """Yield the laws whose place the fit leaves where it is, between the places at which they were looked at."""
    known, sharp = known_values(state), [entry.law for entry in sorted(singles, key=lambda e: -e.score)]
    sharp = [law for law in sharp if _is_sharp(law) and law.terms[0].form in forms]
    for law in sharp[:_FINER]:
        alike = [other.terms[0].values["at"] for other in sharp if other.name == law.name]
        yield from (Law(law.link, (term,)) for term in finer(law.terms[0], known[law.terms[0].covariate], alike))


def _is_sharp(law: Law) -> bool:
    """Return whether it has a single term whose only place the fit leaves where it is."""
    return [term.form for term in law.terms] in (["step"], ["border"])


def _products(state: FitState, singles: Iterable[Screened]) -> Iterator[Law]:
    """Yield the best laws of one term times a term of another covariate."""
    known = known_values(state)
    for place in PLACES if "source_level" in known else ():
        tilts = [term for term in terms_of(place, known) if term.form in ("ramp", "bow")]
        levels = [term for term in terms_of("source_level", known) if term.form in ("power", "step")]
        yield from (Law("scene", (tilt, level)) for tilt in tilts for level in levels)
    for entry in _distinct((entry for entry in singles if not _goes_alone(entry.law)), _MULTIPLIED):
        own = entry.law.terms[0]
        for name in known:
            if name in (*own.covariates, "signal", "value", "frame") or {name, own.covariate} <= _OF_A_PLACE:
                continue
            further = [term for term in terms_of(name, known) if term.form in _SECOND]
            for link in _links_of_product(entry.law.link, own.covariate, name):
                yield from (Law(link, (own, term)) for term in further)


def _goes_alone(law: Law) -> bool:
    return law.link in _ALONE or "frame" in law.covariates


def _links_of_product(link: str, first: str, second: str) -> tuple[str, ...]:
    """Return where a product may act: at its first factor's place, and in the scene where it depends on the drive."""
    scenic = "source_level" in (first, second) and (first in PLACES or second in PLACES)
    if scenic:
        return ("scene",)
    return (link,)


def _distinct(screened_: Iterable[Screened], most: int) -> list[Screened]:
    """Return the best laws that differ in formula, whatever their stage."""
    found: dict[tuple[tuple[str, str], ...], Screened] = {}
    for entry in sorted(screened_, key=lambda entry: -entry.score):
        found.setdefault(_formula(entry.law), entry)
    return list(islice(found.values(), most))


def _formula(law: Law) -> tuple[tuple[str, str], ...]:
    return tuple((term.form, term.covariate) for term in law.terms)


def _chosen(entries: Iterable[Screened]) -> list[Screened]:
    """Return what is fitted: of each stage and formula the best start, of each formula the best stages."""
    kinds: dict[tuple[str, object], list[Screened]] = {}
    for entry in sorted(entries, key=lambda entry: -entry.score):
        kinds.setdefault((entry.law.link, _formula(entry.law)), []).append(entry)
    taken: list[Screened] = []
    for entry, *others in kinds.values():
        most = _PLACES if _is_sharp(entry.law) else _STARTS
        near = tuple(other for other in others if other.gain > _NEAR * entry.gain)[:most]
        entry = replace(entry, others=near)
        alike = [other for other in taken if _formula(other.law) == _formula(entry.law)]
        if (len(alike) <= _OF_A_KIND or entry.law.link in _PLAIN) and entry.score > 0:
            taken.append(entry)
    return taken[:_FITTED]


# ---- judged as effects -------------------------------------------------------------------------------------

_JudgedLaw = tuple[Law, FittedCandidate, float]


def _judged(fits: FullFits, chosen: list[Screened], say: Say) -> list[_JudgedLaw]:
    """Return the laws fitted to all statistics, with the nats that they improve held-out settings by.

    Those that leave too much though the nuisances follow are not among them; where entries are far off, these follow
    too badly to judge.
    """
    fitted, state = list[tuple[Law, FittedCandidate]](), fits.state
    most = np.inf if is_far(state) else fits.most
    for entry in chosen:
        effect = _started(entry)
        if effect is None:
            continue
        try:
            others = tuple(start for other in entry.others if (start := _started(other)) is not None)
            candidate = Candidate(effect, entry.gain, entry.law.size, others=others)
            fitted.append((entry.law, fit_candidate(state, candidate, most)))
        except (UnfitError, MeasurementError, np.linalg.LinAlgError):
            continue
    fitted = [pair for pair in fitted if state.cost - pair[1].gain < most]
    fitted.sort(key=lambda pair: -pair[1].gain + 2.0 * PARAMETER_NATS * pair[0].size)
    rated = [(f, judged_gain(state, f)) for _, f in fitted[:_JUDGED]]
    laws = {id(f): law for law, f in fitted}
    contenders = _fitted_in_full(fits, rated)
    for f, nats in contenders:
        say(f"{f.name}: {nats:.0f} nats")
    return [(laws[id(f)], f, nats) for f, nats in contenders]


def _fitted_in_full(fits: FullFits, rated: list[tuple[FittedCandidate, float]]) -> list[tuple[FittedCandidate, float]]:
    """Return the laws that contend; one with which the model predicts what no camera does is none of them."""
    while rated:
        try:
            return contenders_of(fits, rated)
        except UnfitError as unfit:
            rated = [(fitted, nats) for fitted, nats in rated if fitted.name != str(unfit)]
    return []


def _started(entry: Screened) -> CatalogueEffect | None:
    """Return the effect at the screened parameters; None where its amplitude is nothing."""
    return effect_of(entry.law, round_to(entry.amplitude)) if entry.amplitude else None


def _plainest(judged: Sequence[_JudgedLaw]) -> _JudgedLaw:
    """Return the law of the highest score; of those that the data hardly rule out one of a plain stage."""
    most = max(_score(entry) for entry in judged)
    near = [entry for entry in judged if most - _score(entry) < RIVAL_NATS]
    return min(near, key=lambda entry: (entry[0].link not in _PLAIN, -_score(entry)))


def _without_its_second(fits: FullFits, best: _JudgedLaw, judged: Sequence[_JudgedLaw]) -> _JudgedLaw:
    """Return a law without its second factor where a free curve along the first one's covariate does as well.

    Where the disagreement is huge, a form that is a little off leaves more than chance. Any law that mostly depends
    on its covariate would absorb that.
    """
    law, fitted, _ = best
    if len(law.terms) < 2:
        return best
    try:
        most = worth(fits.included(fitted.effect, far=True)) - NAMED_NATS
        parts = [e for e in judged if e[0].link == law.link and set(_formula(e[0])) < set(_formula(law))]
        for own in sorted(parts, key=_score, reverse=True):
            forms = free_forms(fits.included(own[1].effect, far=True), own[1].effect)
            if any(worth(included(fits.state, form, far=True)) > most for form in forms):
                return own
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # what cannot be fitted does not stand in for it
        return best
    return best


def _holds(law: Law, other: Law) -> bool:
    """Return whether a law is another one times something more."""
    return law.link == other.link and set(_formula(other)) < set(_formula(law))


def _score(entry: _JudgedLaw) -> float:
    """Return the nats of a law less what its parameters cost, and what a second factor does."""
    law, _, nats = entry
    return nats - PARAMETER_NATS * law.size - NAMED_NATS * (len(law.terms) - 1)
