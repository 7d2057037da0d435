"""What speaks against names that no test contradicts: scatter without any trend, names that only do together what one
other might, entries of which only the further terms fit or whose parameters make them another, and little
evidence that others claim too.

The tests of `localise` look for trends. What moves single tiles or frames at random leaves none, but a reduced χ²
above 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from radiometer.reconcile.fit.comparison import FAMILY, TILE_BLOCKS
from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.measure.covariates import covariates
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.report.result import FittedParameter
from radiometer.reconcile.search.places import axis_of
from radiometer.reconcile.search.search import Step
from simulators.effects.catalogue import CatalogueEffect

_SIGMAS: Final = 5.0  # of a χ² of so many entries; the gap of 330 sets without an effect was 1.02 at most
LITTLE_NATS: Final = 40.0  # what an effect at its smallest realistic size brings; rivals lie within 5
_SEVERAL: Final = 2
_SHOWN_SIGMAS: Final = 3.0
_SMALLEST: Final = 1.05  # gap that counts as closed


def is_scattered(state: FitState) -> bool:
    """Tell whether the held-out gap lies above 1 by more than chance."""
    settings = int(state.design.setting_id.max()) + 1
    count = max(float(state.held_out.count[:settings].sum()), 1.0)
    return state.gap > max(_SMALLEST, 1.0 + _SIGMAS * float(np.sqrt(2.0 / count)))


def place_of_scatter(state: FitState) -> tuple[str, str]:
    """Return the statistic that scatters most beyond its uncertainties, and the covariate along which it does so."""
    comparison, square = state.comparison, np.square(state.data_residual)
    more = {n: float(np.sum(square[cut])) - comparison.degrees(n) for n, cut in comparison.cuts.items()}
    block = max(more, key=lambda name: more[name])
    mask = comparison.usable[block]
    excess = np.where(mask, square[comparison.cuts[block]].reshape(mask.shape) - 1.0, 0.0)
    tiled = block in TILE_BLOCKS
    shares = {}
    for name, axis in covariates(state.model, state.prediction).items():
        if tiled or axis.per_capture:
            basis = axis.basis() if tiled else axis.basis()[:, 0]
            values = excess if tiled else excess.reshape(len(excess), -1).sum(axis=1)
            counted = mask if tiled else mask.reshape(len(mask), -1).any(axis=1)
            shares[name] = _explained(values[counted], basis[counted])
    where = max(shares, key=lambda name: shares[name], default="constant")
    return FAMILY.get(block, block), axis_of(where, block)


def _explained(values: Array, basis: Array) -> float:
    """Return the share of the values' variance that a basis explains, each of its terms worth one value less."""
    columns = np.column_stack([np.ones(len(values)), basis])
    left: Array = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    freedom = max(len(values) - columns.shape[1], 1)
    return float(1.0 - np.sum(left**2) / freedom / max(float(np.var(values)), 1e-30))


def replaceable(steps: Sequence[Step], effects: Sequence[CatalogueEffect]) -> list[str]:
    """Return the entries that stand as rivals beside every one of several names: one cause may do what they all do.

    Args:
        steps: What was added, in order.
        effects: The effects of the model.
    """
    present = {effect.name for effect in effects}
    named = [step for step in steps if step.name in present]
    if len(named) < _SEVERAL:
        return []
    return sorted(set.intersection(*({rival.name for rival in step.rivals} for step in named)) - present)


def outdone(steps: Sequence[Step], effects: Sequence[CatalogueEffect]) -> list[str]:
    """Return the names for which only what is usual speaks: something else predicts better.

    Args:
        steps: What was added, in order.
        effects: The effects of the model.
    """
    present = {effect.name for effect in effects}
    return [step.name for step in steps if step.outdone and step.name in present]


def hollow(effects: Sequence[CatalogueEffect], parameters: Mapping[str, Mapping[str, FittedParameter]]) -> list[str]:
    """Return the names of effects of which an essential parameter lies within three standard uncertainties of zero.

    Args:
        effects: The effects of the model.
        parameters: Their fitted parameters by effect and name.
    """
    found = []
    for effect in effects:
        fitted = parameters[effect.name]
        shown = (fitted[name] for name in effect.essential if name in fitted)
        if any(entry.u is not None and abs(entry.value) < _SHOWN_SIGMAS * entry.u for entry in shown):
            found.append(effect.name)
    return found


def contested(steps: Sequence[Step], effects: Sequence[CatalogueEffect]) -> list[str]:
    """Return the names that bring little where another entry might take them, or beside others that bring more.

    What is left of a law that is not quite the one that was named looks like one more effect, but a faint one.

    Args:
        steps: What was added, in order.
        effects: The effects of the model.
    """
    present = {effect.name for effect in effects}
    named = [step for step in steps if step.name in present]
    most = max((step.gain_nats for step in named), default=0.0)
    return [s.name for s in named if s.gain_nats < LITTLE_NATS and (s.rivals or s.gain_nats < most)]


def merged(state: FitState) -> list[str]:
    """Return the names of effects that, with their fitted parameters and these settings, act as other causes do."""
    return [effect.name for effect in state.effects if effect.unlike_itself(state.model.context)]
