"""Gives an effect that was named already a more flexible form, where structure stays beside its rigid one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconcile.fit.state import FitState, refit, settled, with_effects
from radiometer.reconcile.search.rivals import PARAMETER_NATS
from radiometer.reconcile.search.screening import change_of
from simulators.effects.catalogue import CatalogueEffect

_REFITTED: Final = 2  # forms that are fitted in full, the most promising first
_NEEDED_NATS: Final = 8.0
_OWN_NATS: Final = 2.0  # where an effect's own tests already tell that its rigid form is not quite the law
_STEP: Final = 0.1  # of a parameter's scale


@dataclass(frozen=True, slots=True, eq=False)
class Loosened:
    """A model in which one effect took a more flexible form.

    Attributes:
        name: Name of the effect.
        state: The fitted model.
        nats: Improvement of the held-out log density.
        further: Number of parameters that the form has beyond the former one.
    """

    name: str
    state: FitState
    nats: float
    further: int


def loosened(state: FitState, only: Sequence[str] | None = None) -> Loosened | None:
    """Return the model with the flexible form that predicts held-out settings best; None where none is worth it.

    Each further parameter must be paid for, and the whole be as far beyond chance as a further name.

    Args:
        state: The fitted model.
        only: Names of the effects that leave structure in their own place, where these alone are asked and the tests
            of that place are what is beyond chance; by default all effects.
    """
    needed = _NEEDED_NATS if only is None else _OWN_NATS
    promising = ((nats, i, form) for nats, i, form in _promising(state, only) if nats >= needed)
    forms = sorted(promising, key=lambda entry: -entry[0])[:_REFITTED]
    fitted = [_fitted(state, index, form) for _, index, form in forms]
    worth = [entry for entry in fitted if entry is not None and entry.nats - PARAMETER_NATS * entry.further >= needed]
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
    at = change_of(state, effects)
    own = state.parameters_of(effects).differences(lambda changed: change_of(state, changed), at, _STEP, index)
    gain, _ = state.fit.score(slice(0, state.comparison.size), state.fit.followed(np.column_stack([at, own])))
    return float(gain)


def _fitted(state: FitState, index: int, form: CatalogueEffect) -> Loosened | None:
    """Return the model with a form in an effect's place, fitted; it stands last, as the newest of all.

    None where the form cannot be fitted: with it the model predicts what no camera does.
    """
    others = [effect for place, effect in enumerate(state.effects) if place != index]
    try:
        following = settled(refit(with_effects(state, [*others, form])))
    except (np.linalg.LinAlgError, ConfigurationError):  # no covariance, or parameters that are no numbers
        return None
    further = _further(state.effects[index], form)
    return Loosened(form.name, following, following.evidence - state.evidence, further)
