"""Other causes in place of those that were named: an entry that acts along two settings may have been taken for two, a
freer one may have been named where a plainer does as much, and what was named first knew nothing of what came later."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconcile.fit.candidate_fit import UnfitError, fit_candidate, included, judged_gain
from radiometer.reconcile.fit.state import FitState, refit, settled, with_effects
from radiometer.reconcile.search.judging import contenders_of, likeliest
from radiometer.reconcile.search.rivals import PARAMETER_NATS
from radiometer.reconcile.search.screening import screen
from radiometer.reconcile.search.starts import StartPool
from simulators.effects.catalogue import CatalogueEffect

_FITTED: Final = 4  # entries that are fitted in another's place
_BETTER_NATS: Final = 8.0  # by which one must predict better than what it takes the place of


def better(
    state: FitState, name: str, catalogue: Mapping[str, type[CatalogueEffect]], pool: StartPool
) -> tuple[FitState, CatalogueEffect] | None:
    """Return the model with another entry in place of one, where it predicts better beside what was named later.

    Args:
        state: The model with all names so far.
        name: The name in question.
        catalogue: Entries that may be named.
        pool: Their starts.

    Returns:
        The model and the entry as it was fitted; None where no entry predicts better.
    """
    own = next(effect for effect in state.effects if effect.name == name)
    present = {effect.name for effect in state.effects}
    try:
        rest = settled(refit(with_effects(state, [effect for effect in state.effects if effect is not own])))
        others = [candidate for candidate in screen(rest, catalogue, pool) if candidate.effect.name not in present]
        judged = [(fitted, judged_gain(rest, fitted)) for fitted in (fit_candidate(rest, c) for c in others[:_FITTED])]
        chosen = likeliest(contenders_of(rest, judged))
        if chosen is None:
            return None
        fitted = chosen[0]
        changed = included(rest, fitted.effect, far=True)
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # what cannot be fitted takes no place
        return None
    more = PARAMETER_NATS * (changed.parameters.size - state.parameters.size)
    if changed.evidence - more < state.evidence + _BETTER_NATS:
        return None
    return changed, next(effect for effect in changed.effects if effect.name == fitted.name)


def simpler(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> tuple[FitState, CatalogueEffect] | None:
    """Return the model with one entry in place of those that it may stand for, where fewer parameters predict as well.

    Each parameter that is saved is worth what a further one must bring.

    Args:
        state: The model with all names so far.
        catalogue: Entries that may be named.

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
