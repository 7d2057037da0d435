"""One score for all models: the held-out log density plus the log prior odds of the names, each parameter paid for.

What a candidate must bring before it is a name, and which others explain the data about as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from radiometer.reconcile.fit.candidate_fit import FittedCandidate, fit_candidate, held_out_gain, included
from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.noise.chances import chi2_beyond
from radiometer.reconcile.search.screening import best_start
from radiometer.reconcile.thresholds import (
    FEW_TRIES,
    FLEXIBLE_NATS,
    HUGE_NATS,
    LATER_NATS,
    NAMED_NATS,
    NEAR_SHARE,
    PARAMETER_NATS,
    RIVAL_NATS,
    SHOWN_CHI2,
    STATED_NATS,
    STATED_SHARE,
)
from simulators.effects.catalogue import CatalogueEffect

_SAME_GAIN: Final = 0.8  # of the chosen one's, below which an entry is not fitted
_LEFT: Final = 1e-4  # share of what an entry does that the nuisances must leave

Judged = tuple[FittedCandidate, float]


def penalised_chi2(fitted: FittedCandidate) -> float:
    """Return the χ² that a candidate explains, less what it pays for its parameters and for being unlikely."""
    return fitted.gain - 2.0 * _penalty(fitted)


def _penalty(fitted: FittedCandidate) -> float:
    return PARAMETER_NATS * fitted.parameters - fitted.effect.log_prior_odds


def score(entry: tuple[FittedCandidate, float]) -> float:
    """Return the nats of a judged candidate less what it pays."""
    fitted, nats = entry
    return nats - _penalty(fitted) - (FLEXIBLE_NATS if fitted.flexible else 0.0)


def contenders_of(
    state: FitState, judged: list[tuple[FittedCandidate, float]], fewest: int = 1
) -> list[tuple[FittedCandidate, float]]:
    """Return the candidates, those of a very large and nearly equal gain judged anew after a full fit of each.

    Beside a huge disagreement the linearised nuisances and the weights of the old model are poor judges. With fewer
    than `fewest` left all are returned as they came.
    """
    best = max((nats for _, nats in judged), default=0.0)
    near = [entry for entry in judged if entry[1] > best - NEAR_SHARE * best]
    if best < HUGE_NATS or len(near) < max(fewest, 2):
        return judged
    base = state.evidence
    return [(f, included(state, f.effect, far=True).evidence - base) for f, _ in near]


def likeliest(judged: list[tuple[FittedCandidate, float]]) -> tuple[FittedCandidate, float] | None:
    """Return the judged candidate of the highest score."""
    return max(judged, key=score) if judged else None


def log_chance(gain: float, parameters: int) -> float:
    """Return ln of the chance that so many idle parameters gain so much χ²."""
    chance = chi2_beyond(max(gain, 1e-9), parameters)
    return float(np.log(chance)) if chance > 0 else -np.inf


def is_shown(fitted: FittedCandidate, nats: float, limit: float, *, later: bool) -> bool:
    """Tell whether settings held out are predicted better, beyond chance, and in the statistic that must show it.

    Of many starts one fits by chance, and beside an effect that is there already a further one is less likely. The
    radiances of patches are stated once: an error of their measurement that goes with the level looks like an effect.
    """
    needed = NAMED_NATS - fitted.effect.log_prior_odds + float(np.log(max(fitted.tries / FEW_TRIES, 1.0)))
    needed += STATED_NATS if fitted.stated > STATED_SHARE * fitted.gain else 0.0
    needed += FLEXIBLE_NATS if fitted.flexible else 0.0
    beyond_chance = log_chance(fitted.gain, fitted.parameters) < limit
    return beyond_chance and nats >= needed + (LATER_NATS if later else 0.0) and fitted.evidence >= SHOWN_CHI2


def rivals_of(
    state: FitState,
    chosen: Judged,
    judged: Sequence[Judged],
    linear: Judged,
    catalogue: Mapping[str, type[CatalogueEffect]],
) -> tuple[CatalogueEffect, ...]:
    """Return the effects, at their best parameters, that the data cannot tell from the chosen one.

    Args:
        state: The model without the chosen one.
        chosen: The chosen one with its gain in nats.
        judged: Others that were fitted and judged in the same way, with theirs.
        linear: The chosen one with its gain before any full fit.
        catalogue: All entries. Those that were not tried, because the setting that marks them does not vary, may
            act like the chosen one for that very reason: a blur that grows with the aperture at one f-number.
    """
    found = {f.name: f.effect for f, nats in judged if _is_rival(f, nats, chosen)}
    found |= {f.name: f.effect for f, nats in _unvaried(state, linear, catalogue) if _is_rival(f, nats, linear)}
    return tuple(found.values())


def _is_rival(other: FittedCandidate, nats: float, chosen: Judged) -> bool:
    """Tell whether another entry predicts about as well; each further parameter must be paid for.

    One with more parameters of which one lies on its bound is the chosen one's likeness in a limit: a wing as wide as
    the picture is a veil.
    """
    further = max(other.parameters - chosen[0].parameters, 0)
    if other.name == chosen[0].name or (further and other.columns.shape[1] < other.parameters):
        return False
    return nats - PARAMETER_NATS * further > chosen[1] - RIVAL_NATS


def _unvaried(state: FitState, chosen: Judged, catalogue: Mapping[str, type[CatalogueEffect]]) -> list[Judged]:
    context = state.model.context
    present = {effect.name for effect in (*state.effects, *state.model.given)}
    found = []
    for name, kind in catalogue.items():
        if name in present or kind.block != chosen[0].effect.block or kind.usable(context):
            continue
        start = best_start(state, kind.starts(context))
        if start is not None and start.gain > _SAME_GAIN * chosen[0].gain:
            fitted = fit_candidate(state, start)
            if not _is_absorbed(state, fitted):
                found.append((fitted, held_out_gain(state, fitted.residual, fitted.columns)))
    return found


def _is_absorbed(state: FitState, fitted: FittedCandidate) -> bool:
    """Tell whether the nuisances take up all that an entry does: it is nobody's rival, whatever is left of it fits."""
    part = state.fit.half(state.fit.pull(fitted.columns))
    whole = np.sum(fitted.columns**2, axis=0)
    return bool(np.all(whole - np.sum(part**2, axis=0) < _LEFT * np.maximum(whole, 1e-12)))
