"""One cause in place of others: an entry that acts along two settings may have been taken for two, and a freer one may
have been named where a plainer does as much."""

from __future__ import annotations

from collections.abc import Mapping

from radiometer.reconcile.candidate_fit import UnfitError, included
from radiometer.reconcile.rivals import PARAMETER_NATS
from radiometer.reconcile.state import FitState, with_effects
from simulators.effects.catalogue import CatalogueEffect


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
