"""Forms of an effect with a free law along its covariates, and what a model is worth that holds one."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np

from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.thresholds import PARAMETER_NATS
from radiometer.typing import Mask
from simulators.chain.stages import place_for
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw, axis_scale, axis_values, freed, unscaled
from simulators.effects.tile_moments import TileMoments

_KNOTS: Final = (5, 9)
_OF_TWO: Final = 6  # of the first of two covariates
_LEVELS: Final = 6  # of a covariate, each of which is a knot


def free_forms(state: FitState, effect: CatalogueEffect) -> tuple[FreeLaw, ...]:
    """Return an effect with a free law: along each of its covariates, and along two together.

    Args:
        state: The model, which gives the signals in front of the effect.
        effect: The effect by its own law.
    """
    if isinstance(effect, FreeLaw) or not effect.free() or any("[" in name for name in effect.free()):
        return ()
    along = effect.law_along or (effect.where,)
    knots = {axis: [_knots(state, effect, axis, count) for count in _KNOTS] for axis in along}
    single = [{axis: at} for axis, several in knots.items() for at in dict.fromkeys(several) if at]
    both = [
        {first: _knots(state, effect, first, _OF_TWO), second: knots[second][0]}
        for first, second in itertools.combinations(along, 2)
        if knots[first][0] and knots[second][0]
    ]
    return tuple(_freed(effect, at) for at in (*single, *both))


def _freed(effect: CatalogueEffect, at: Mapping[str, tuple[float, ...]]) -> FreeLaw:
    size = int(np.prod([len(values) for values in at.values()]))
    own = effect.values() | {"law": (1.0,) * size} | {f"at_{axis}": values for axis, values in at.items()}
    return freed(type(effect), tuple(at))(**own)


def _knots(state: FitState, effect: CatalogueEffect, axis: str, count: int) -> tuple[float, ...]:
    """Return the places of so many knots along a covariate; each of few levels is one, none where it does not vary."""
    before = state.trace.in_front(place_for(effect, state.trace.links))
    values = axis_values(effect, axis, before.mean, state.model.context)
    if values is None:
        return ()
    mask = state.comparison.usable["mean"][:, :, None] & _acts(state, effect, before)
    spread = np.broadcast_to(axis_scale(axis, values), np.broadcast_shapes(np.shape(values), mask.shape))
    held = spread[np.broadcast_to(mask, spread.shape)]
    levels = np.unique(np.round(held[np.isfinite(held)], 6))
    if levels.size < 2:
        return ()
    if levels.size > _LEVELS:
        share = np.linspace(0.0, 1.0, count)
        levels = 0.5 * (np.quantile(levels, share) + levels[0] + share * (levels[-1] - levels[0]))
    return tuple(unscaled(axis, levels).tolist())


def _acts(state: FitState, effect: CatalogueEffect, before: TileMoments) -> Mask:
    """Return where an effect does anything at all: elsewhere no law of it can be seen."""
    after = effect.moments(before, state.model.context)
    names = ("mean", *before.squared, *before.linear)
    moved = [np.not_equal(getattr(after, name), getattr(before, name)) for name in names]
    return np.asarray(np.broadcast_to(np.any(np.broadcast_arrays(*moved), axis=0), before.mean.shape))


def worth(state: FitState) -> float:
    """Return the score of a model: its held-out log density, each parameter and each column of a curve paid for."""
    columns = sum(term.size for term in state.terms if term.is_smooth)
    return state.evidence - PARAMETER_NATS * (state.parameters.size + columns)
