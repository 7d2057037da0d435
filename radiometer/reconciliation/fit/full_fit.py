"""Fits models with a further effect in full: nuisances, weights and all effects together."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.fit.candidate_fit import FittedCandidate
from radiometer.reconciliation.fit.covariance import is_far
from radiometer.reconciliation.fit.descent import coarse_fit, converged_fit
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.thresholds import HUGE_NATS, NEAR_SHARE
from simulators.effects.catalogue import CatalogueEffect


class UnfitError(ArithmeticError):
    """An effect cannot be fitted to the data, or not so far as it must; its name is the argument."""


def accepted(state: FitState, effect: CatalogueEffect) -> FitState:
    """Return the state with the effect in the model, not refitted yet; one that repeats joins its like."""
    effects = tuple(old.joined(effect) if old.name == effect.name else old for old in state.effects)
    if all(old.name != effect.name for old in state.effects):
        effects = (*effects, effect)
    return with_effects(state, effects)


def included(
    state: FitState, effect: CatalogueEffect, *, far: bool, most: float = np.inf, early_stop: bool = False
) -> FitState:
    """Return the state with the effect in the model, refitted in full.

    Args:
        state: The model without it.
        effect: The effect at its best parameters, nuisances having followed linearly.
        far: Whether the nuisances stand so far off that they had better move first, and the effect's parameters then.
        most: χ² under the weights of the state that it may leave, to be refitted under its own.
        early_stop: Whether it ends where it creeps (`refit`).

    Raises:
        UnfitError: If with it the model predicts what no camera does, or leaves more than that.
    """
    following = accepted(state, effect)
    try:
        if far:
            own = following.parameters.owner
            mine = frozenset(i for i, at in enumerate(own) if following.effects[at].name == effect.name)
            following = replace(coarse_fit(replace(following, frozen=mine), early_stop=early_stop), frozen=frozenset())
        near = coarse_fit(following, early_stop=early_stop)
        if near.cost > most:
            raise UnfitError(effect.name)
        return converged_fit(near, early_stop=early_stop)
    except (np.linalg.LinAlgError, ConfigurationError) as error:  # no covariance, or parameters that are no numbers
        raise UnfitError(effect.name) from error


class FullFits:
    """Full fits from one model, kept so that nothing is fitted twice while a step is decided.

    Attributes:
        state: The model.
        most: χ² under its weights that a fit may leave; with such a bound fits stop early, since they are compared
            with what was found.
    """

    def __init__(self, state: FitState, most: float = np.inf) -> None:
        self.state, self.most = state, most
        self._known: list[tuple[CatalogueEffect, bool, FitState]] = []

    def included(self, effect: CatalogueEffect, *, far: bool) -> FitState:
        """Return `included` of the model and an effect."""
        for known, was_far, fitted in self._known:
            if known is effect and was_far is far:
                return fitted
        early_stop = bool(np.isfinite(self.most))
        fitted = included(self.state, effect, far=far, most=self.most, early_stop=early_stop)
        self._known.append((effect, far, fitted))
        return fitted

    def try_out(self, effect: CatalogueEffect, *, far: bool) -> None:
        """Fit the model and an effect in full, so that its posterior probability is comparable, if it can be fitted."""
        with contextlib.suppress(UnfitError):
            self.included(effect, far=far)


def contenders_of(
    fits: FullFits, judged: list[tuple[FittedCandidate, float]], fewest: int = 1
) -> list[tuple[FittedCandidate, float]]:
    """Return the candidates, those of a very large and nearly equal gain judged anew after a full fit of each.

    Beside a huge disagreement the linearised nuisances and the weights of the old model are poor judges; where entries
    are off by ten of their uncertainties and more, of all candidates. With fewer
    than `fewest` left all are returned as they came.
    """
    best = max((nats for _, nats in judged), default=0.0)
    share = 1.0 if is_far(fits.state) else NEAR_SHARE
    near = [entry for entry in judged if entry[1] > best - share * best]
    if best < HUGE_NATS or len(near) < max(fewest, 2):
        return judged
    base = fits.state.evidence
    return [(f, fits.included(f.effect, far=True).evidence - base) for f, _ in near]
