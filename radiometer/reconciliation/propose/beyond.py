"""Names against a cause that no catalogue holds, by the laws that the grammar would propose and by the same score.

A search can only say names that it knows. Where its names leave something, are several, or are doubted, the hypothesis
that the cause is another one is asked too: names that one law outdoes by far are none. A single name that leaves
nothing is compared with the laws along its own covariate: where one of them predicts better, the name is provisional,
or none where it brings far less. A name that had to be bent to the data is provisional where a law predicts as well.

What is known of a name beforehand is its own equation: a table or a curve in its place would follow any law. What names
bring is therefore what their own equations bring, without the curves that represent no cause. A name by another
equation than the catalogue's is not meant by this: its own brings most of what any law along its covariate brings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.fit.candidate_fit import UnfitError, included
from radiometer.reconciliation.fit.covariance import scatter_of
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.posterior import posterior_of
from radiometer.reconciliation.propose.grammar import PLACES
from radiometer.reconciliation.propose.proposal import Proposal
from radiometer.reconciliation.propose.search import propose_law
from radiometer.reconciliation.search.localise import localise, significant
from radiometer.reconciliation.search.moves import in_a_looser_form, nowhere_near
from radiometer.reconciliation.search.outcome import Search, Step
from radiometer.reconciliation.search.score import worth
from radiometer.reconciliation.thresholds import NAMED_NATS, RIVAL_NATS, SMOOTH_SHARE
from radiometer.reconciliation.verdict import acting_as_others, doubts_of, leaves_structure
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw


def held_to_laws(
    outcome: Search,
    catalogue: Mapping[str, type[CatalogueEffect]],
    say: Callable[[str], None] = lambda line: None,
) -> Search:
    """Return the outcome with what laws of no entry say of its names: nothing, a doubt, or that they are none.

    Args:
        catalogue: The entries, one of which may hold the law in a looser form.
        say: Told what happens.
    """
    effects = outcome.state.effects
    if not effects:
        return outcome
    stays = (
        len(effects) > 1
        or leaves_structure(outcome)
        or bool(doubts_of(outcome, posterior_of(outcome.state, catalogue)))
    )
    along = () if stays else own_covariates(effects[0])
    law = propose_law(outcome.start, along=along, most=nowhere_near(outcome.start, outcome.state))
    if law is None:
        return outcome
    if lead_nats(outcome, law) <= NAMED_NATS:
        bent = [effect.name for effect in effects if is_bent(effect, outcome)]
        if not bent or lead_nats(outcome, law) <= -RIVAL_NATS:
            return outcome
        remark = (
            f"{' and '.join(bent)} does not follow its catalogue equation, "
            f"and {law.name}, a law outside the catalogue, predicts as well"
        )
        say(remark)
        return replace(outcome, remarks=(*outcome.remarks, remark))
    named = " and ".join(step.name for step in outcome.steps if step.name != "unnamed")
    remark = f"{law.name}, a law outside the catalogue, predicts better than {named}"
    if brings_most(outcome, law):
        say(remark)
        return replace(outcome, remarks=(*outcome.remarks, remark))
    near = nowhere_near(outcome.start, law.after)
    form = in_a_looser_form(outcome.start, worth(law.after) - RIVAL_NATS, catalogue, near)
    if form is not None:
        say(f"{form.effects[0].name} in a more flexible form explains what {law.name} explains, in place of {named}")
        return by_one_form(outcome, form, law)
    say(remark)
    return without_names(outcome, law, f"{remark} (gap {law.after.gap:.3g}), which is therefore not named")


def by_one_form(outcome: Search, state: FitState, law: Proposal) -> Search:
    """Return the outcome in which one entry in a looser form replaces all names; it is provisional."""
    (effect,) = state.effects
    nats, tests = state.evidence - outcome.start.evidence, localise(state)
    step = Step(effect.name, effect.where, nats, outcome.start.gap, state.gap)
    remark = (
        f"{effect.name} follows a more flexible form of its equation, and {law.name}, a law of the grammar, "
        "predicts as well"
    )
    return replace(outcome, state=state, steps=(step,), left=significant(tests), tests=tests, remarks=(remark,))


def own_covariates(effect: CatalogueEffect) -> tuple[str, ...]:
    """Return the covariates of laws that an entry may follow; a place of screen or lens is one of the picture."""
    found = list[str]()
    for where in type(effect).law_along or (effect.where,):
        is_place = where in ("field_radius", "screen_x", "screen_y", *PLACES)
        found += PLACES if is_place else ("signal", "value") if where == "signal" else (where,)
    return tuple(dict.fromkeys(found))


def lead_nats(outcome: Search, law: Proposal) -> float:
    """Return by how many nats a law predicts better than what was found, each parameter paid for.

    An entry by its own equation is known beforehand, a law is not: it must lead by the odds of a name. An entry that
    had to be bent has that no more; a rival is as good.
    """
    return (worth(law.after) - worth(outcome.state)) / scatter_of(outcome.state)


def brings_most(outcome: Search, law: Proposal) -> bool:
    """Return whether names stand though a law predicts better: it is their own law, by an equation unlike theirs.

    Their own equations need to bring most of what the law brings and to leave nothing, unless the law depends on the
    covariate of the only name. One that acts as other causes would has brought nothing new.
    """
    if acting_as_others(outcome.state):
        return False
    base = worth(outcome.start)
    if worth(by_own_equations(outcome)) - base < SMOOTH_SHARE * (worth(law.after) - base):
        return False
    effects = outcome.state.effects
    own = len(effects) == 1 and set(law.law.covariates) <= set(own_covariates(effects[0]))
    return own or not leaves_structure(outcome)


def is_bent(effect: CatalogueEffect, outcome: Search) -> bool:
    """Return whether an effect took a form with parameters that its own equation has not, or a free law."""
    return own_equation(effect, outcome) is not effect


def own_equation(effect: CatalogueEffect, outcome: Search) -> CatalogueEffect:
    """Return an effect by its own equation, at the parameters that it shares with the form that it took."""
    own = effect.own if isinstance(effect, FreeLaw) else effect
    plain = min(type(own).starts(outcome.start.model.context), key=lambda start: len(start.free()))
    if set(own.free()) <= set(plain.free()):
        return own
    shared = (name for name in plain.free() if "[" not in name)
    return plain.with_parameters(**{name: getattr(own, name) for name in shared})


def by_own_equations(outcome: Search) -> FitState:
    """Return the model with the names by their own equations, fitted anew, without any unnamed curve."""
    state = outcome.state
    if not any(is_bent(effect, outcome) for effect in state.effects) and not any(t.is_smooth for t in state.terms):
        return state
    plain = outcome.start
    try:
        for effect in state.effects:
            plain = included(plain, own_equation(effect, outcome), far=True)
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # they bring what those bring that can be fitted
        pass
    return plain


def without_names(outcome: Search, law: Proposal, remark: str) -> Search:
    """Return the outcome in which all that disagrees is one entry without a name, placed as the law is."""
    named = [step for step in outcome.steps if step.name != "unnamed"]
    nearest = max(named, key=lambda step: step.gain_nats)
    step = Step(
        "unnamed",
        law.law.where,
        law.nats,
        outcome.start.gap,
        law.after.gap,
        closest=(nearest.name, min(nearest.gain_nats / law.nats, 1.0)),
        block="mean",
    )
    tests = outcome.first_tests
    return replace(outcome, state=outcome.start, steps=(step,), left=significant(tests), tests=tests, remarks=(remark,))
