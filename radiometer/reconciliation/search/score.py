"""One score for all models: the held-out log density plus the log prior odds of the names, each parameter paid for.

What a candidate must bring before it is a name, and which others explain the data about as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiometer.reconciliation.chances import chi2_beyond
from radiometer.reconciliation.fit.candidate_fit import FittedCandidate
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.thresholds import (
    FEW_TRIES,
    FLEXIBLE_NATS,
    HUGE_NATS,
    LATER_NATS,
    NAMED_NATS,
    PARAMETER_NATS,
    RIVAL_NATS,
    SHOWN_CHI2,
    STATED_NATS,
    STATED_SHARE,
)
from simulators.effects.catalogue import CatalogueEffect

Judged = tuple[FittedCandidate, float]


def worth(state: FitState) -> float:
    """Return the score of a model: its held-out log density, each parameter and each column of a curve paid for."""
    return state.evidence - PARAMETER_NATS * (state.parameters.size + state.curves)


def rated(state: FitState) -> float:
    """Return the score of a model with the prior odds of its names."""
    return worth(state) + sum(effect.log_prior_odds for effect in state.effects)


def penalised_chi2(fitted: FittedCandidate) -> float:
    """Return the χ² that a candidate explains, less what it pays for its parameters and for being unlikely."""
    return fitted.gain - 2.0 * _penalty(fitted)


def _penalty(fitted: FittedCandidate) -> float:
    return PARAMETER_NATS * fitted.parameters - fitted.effect.log_prior_odds


def score(entry: tuple[FittedCandidate, float]) -> float:
    """Return the nats of a judged candidate less what it pays."""
    fitted, nats = entry
    return nats - _penalty(fitted) - (FLEXIBLE_NATS if fitted.flexible else 0.0)


def likeliest(judged: list[tuple[FittedCandidate, float]]) -> tuple[FittedCandidate, float] | None:
    """Return the judged candidate of the highest score."""
    return max(judged, key=score) if judged else None


def by_itself(full: list[Judged], alone: list[Judged], scatter: float) -> Judged:
    """Return of candidates that a full fit makes as good as the best the one that brings most by itself.

    Where much is still wrong, an entry for which all else must move far may look like anything. Unexplained scatter
    makes nats worth that much less. Within the nats of a rival, the gain with all else near its former place decides.

    Args:
        full: Candidates as their full fits judge them; not none.
        alone: The same and others as they were judged with all else following linearly.
        scatter: By how much χ² counts too high under the best of them.
    """
    near = max(score(entry) for entry in full) - RIVAL_NATS * scatter
    own = {entry[0].name: score(entry) for entry in alone}
    tied = [entry for entry in full if score(entry) >= near]
    return max(tied, key=lambda entry: own.get(entry[0].name, -np.inf) if scatter > 1.0 else score(entry))


def log_chance(gain: float, parameters: int) -> float:
    """Return ln of the chance that so many idle parameters gain so much χ²."""
    chance = chi2_beyond(max(gain, 1e-9), parameters)
    return float(np.log(chance)) if chance > 0 else -np.inf


def is_shown(fitted: FittedCandidate, nats: float, limit: float, *, later: bool, far: bool = False) -> bool:
    """Return whether settings held out are predicted better, beyond chance, and in the statistic that must show it.

    Far off, where nuisances would have to move by much, the statistic is asked by the full fit alone. Of many starts
    one fits by chance, and after a first effect a further one is less likely. The radiances of
    patches are stated once: an error of their measurement that depends on the level looks like an effect.
    """
    needed = NAMED_NATS - fitted.effect.log_prior_odds + float(np.log(max(fitted.tries / FEW_TRIES, 1.0)))
    needed += STATED_NATS if fitted.stated > STATED_SHARE * fitted.gain else 0.0
    needed += FLEXIBLE_NATS if fitted.flexible else 0.0
    beyond_chance = log_chance(fitted.gain, fitted.parameters) < limit
    in_its_own = fitted.evidence >= SHOWN_CHI2 or (far and nats > HUGE_NATS)
    return beyond_chance and nats >= needed + (LATER_NATS if later else 0.0) and in_its_own


def rivals_of(chosen: Judged, judged: Sequence[Judged]) -> tuple[CatalogueEffect, ...]:
    """Return the effects, at their best parameters, that the data cannot separate from the chosen one.

    What the plan cannot separate, because a setting does not vary, is asked of the reported model (`inseparable`).

    Args:
        chosen: The chosen one with its gain in nats.
        judged: Others that were fitted and judged in the same way, with theirs.
    """
    return tuple({f.name: f.effect for f, nats in judged if _is_rival(f, nats, chosen)}.values())


def _is_rival(other: FittedCandidate, nats: float, chosen: Judged) -> bool:
    """Return whether another entry predicts about as well; each further parameter must be paid for.

    One with more parameters, one of them on its bound, imitates the chosen one in a limit: a kernel as wide as the
    picture is a veil.
    """
    further = max(other.parameters - chosen[0].parameters, 0)
    if other.name == chosen[0].name or (further and other.columns.shape[1] < other.parameters):
        return False
    return nats - PARAMETER_NATS * further > chosen[1] - RIVAL_NATS
