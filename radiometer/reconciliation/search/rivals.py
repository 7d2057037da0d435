"""Finds the other entries that explain the data about as well as the chosen one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from radiometer.reconciliation.fit.candidate_fit import FittedCandidate, fit_candidate, held_out_gain
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.search.score import Judged
from radiometer.reconciliation.search.screening import best_start
from radiometer.reconciliation.thresholds import PARAMETER_NATS, RIVAL_NATS
from simulators.effects.catalogue import CatalogueEffect

_SAME_GAIN: Final = 0.8  # of the chosen one's, below which an entry is not fitted
_LEFT: Final = 1e-4  # share of what an entry does that the nuisances must leave


def rivals_of(
    state: FitState,
    chosen: Judged,
    judged: Sequence[Judged],
    linear: Judged,
    catalogue: Mapping[str, type[CatalogueEffect]],
) -> tuple[CatalogueEffect, ...]:
    """Return the effects, at their best parameters, that the data cannot separate from the chosen one.

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
    """Return whether another entry predicts about as well; each further parameter must be paid for.

    One with more parameters, one of them on its bound, imitates the chosen one in a limit: a kernel as wide as the
    picture is a veil.
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
    """Return whether the nuisances absorb an entry entirely: it then rivals no effect."""
    part = state.fit.half(state.fit.pull(fitted.columns))
    whole = np.sum(fitted.columns**2, axis=0)
    return bool(np.all(whole - np.sum(part**2, axis=0) < _LEFT * np.maximum(whole, 1e-12)))
