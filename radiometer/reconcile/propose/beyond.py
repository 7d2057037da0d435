"""Names against a cause that no catalogue holds, by the laws that the grammar would propose and by the same score.

A search can only say names that it knows. Where its names leave something, are several, or are doubted, the hypothesis
that the cause is another one is asked too: names that one law outdoes by far are none. A single name that leaves
nothing is held to the laws along its own covariate: where one of them predicts better, the name is provisional, or
none where it brings far less. A name that had to be bent to the data is provisional where a law predicts as well. A
name by another equation than the catalogue's is not meant by all this: it brings most of what any law along its
covariate brings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from radiometer.reconcile.fit.covariance import scatter_of
from radiometer.reconcile.propose.grammar import PLACES
from radiometer.reconcile.propose.proposal import Proposal
from radiometer.reconcile.propose.search import propose_law
from radiometer.reconcile.search.free_laws import worth
from radiometer.reconcile.search.localise import significant
from radiometer.reconcile.search.outcome import Search, Step
from radiometer.reconcile.thresholds import NAMED_NATS, RIVAL_NATS, SMOOTH_SHARE
from radiometer.reconcile.verdict import doubts_of, leaves_structure
from simulators.effects.free_law import FreeLaw

_WHERE: Final = {"since_frame_s": "timestamp_s", "value": "signal"}  # what results call it


def held_to_laws(outcome: Search, say: Callable[[str], None] = lambda line: None) -> Search:
    """Return the outcome with what laws of no entry say of its names: nothing, a doubt, or that they are none.

    Args:
        outcome: What the search came to.
        say: Told what happens.
    """
    effects = outcome.state.effects
    if not effects:
        return outcome
    stays = len(effects) > 1 or leaves_structure(outcome) or bool(doubts_of(outcome))
    law = propose_law(outcome.start, along=() if stays else own_covariates(effects[0].where))
    if law is None:
        return outcome
    named = [step.name for step in outcome.steps if step.name != "unnamed"]
    if not predicts_better(outcome, law):
        bent = [effect.name for effect in effects if isinstance(effect, FreeLaw)]
        if not bent or not predicts_as_well(outcome, law):
            return outcome
        said = (
            f"{' and '.join(bent)} goes by no equation of its own, and {law.name}, a law of no entry, predicts as well"
        )
        say(said)
        return replace(outcome, remarks=(*outcome.remarks, said))
    said = f"{law.name}, a law that no entry holds, predicts better than {' and '.join(named)}"
    say(said)
    if not brings_most(outcome, law):
        return without_names(outcome, law, f"{said} (gap {law.after.gap:.3g}), which is not named therefore")
    return replace(outcome, remarks=(*outcome.remarks, said))


def own_covariates(where: str) -> tuple[str, ...]:
    """Return the covariates of laws that go with what an entry goes with; a place is one of the picture."""
    if where in ("field_radius", "screen_x", "screen_y", *PLACES):
        return PLACES
    return ("signal", "value") if where == "signal" else (where,)


def predicts_better(outcome: Search, law: Proposal) -> bool:
    """Tell whether the odds are those of a name, each parameter paid for, that it is the law and not what was found.

    Args:
        outcome: What the search came to.
        law: The law proposed for the same data, from the same start.
    """
    return worth(law.after) > worth(outcome.state) + NAMED_NATS * scatter_of(outcome.state)


def predicts_as_well(outcome: Search, law: Proposal) -> bool:
    """Tell whether a law is a rival of what was found, each parameter paid for.

    An entry by its own equation is known beforehand, a law is not; one that had to be bent has that no more.

    Args:
        outcome: What the search came to.
        law: The law proposed for the same data, from the same start.
    """
    return worth(law.after) > worth(outcome.state) - RIVAL_NATS * scatter_of(outcome.state)


def brings_most(outcome: Search, law: Proposal) -> bool:
    """Tell whether names stand though a law predicts better: it is their own law, by an equation unlike theirs.

    They need to bring most of what the law brings and to leave nothing, unless the law goes with the very covariate of
    the only name.

    Args:
        outcome: What the search came to.
        law: The law.
    """
    base = worth(outcome.start)
    if worth(outcome.state) - base < SMOOTH_SHARE * (worth(law.after) - base):
        return False
    effects = outcome.state.effects
    own = len(effects) == 1 and set(law.law.covariates) <= set(own_covariates(effects[0].where))
    return own or not leaves_structure(outcome)


def without_names(outcome: Search, law: Proposal, said: str) -> Search:
    """Return the outcome in which all that disagrees is one entry without a name, placed as the law is.

    Args:
        outcome: What the search came to.
        law: The law that explains more.
        said: What is said of it.
    """
    where = next(iter(law.law.covariates), "signal")
    named = [step for step in outcome.steps if step.name != "unnamed"]
    nearest = max(named, key=lambda step: step.gain_nats)
    step = Step(
        "unnamed",
        _WHERE.get(where, where),
        law.nats,
        outcome.start.gap,
        law.after.gap,
        closest=(nearest.name, min(nearest.gain_nats / law.nats, 1.0)),
        block="mean",
    )
    tests = outcome.first_tests
    return replace(outcome, state=outcome.start, steps=(step,), left=significant(tests), tests=tests, remarks=(said,))
