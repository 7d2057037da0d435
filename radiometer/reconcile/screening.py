"""Tries every entry of the catalogue quickly: how much of the disagreement could it explain at best?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.errors import MeasurementError
from radiometer.reconcile.design import Array
from radiometer.reconcile.parameters import EffectParameters
from radiometer.reconcile.start_pool import StartPool
from radiometer.reconcile.state import FitState
from simulators.effects.catalogue import CatalogueEffect

_LARGEST_AMPLITUDE: Final = 300.0  # a start may be that much too small …
_SMALLEST_CURVATURE: Final = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One start of one entry.

    Attributes:
        effect: The effect at its start.
        gain: χ² that it would explain if it acted linearly.
        parameters: Number of its fitted parameters (one more where it acts without any).
        flexible: Whether it is a cover, a flexible form that takes up any equation of the effect.
    """

    effect: CatalogueEffect
    gain: float
    parameters: int
    flexible: bool = False


def usable_catalogue(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]
) -> dict[str, type[CatalogueEffect]]:
    """Return the entries that the data can speak about at all and that are not in the model yet."""
    taken = {effect.name for effect in state.effects}
    return {n: kind for n, kind in catalogue.items() if n not in taken and kind.usable(state.model.context)}


def screen(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], pool: StartPool | None = None
) -> list[Candidate]:
    """Return the best start of every usable entry (rigid and flexible apart), the most promising first.

    Args:
        state: The fitted model.
        catalogue: Entries to try, by name.
        pool: Their starts, where they were made before.
    """
    pool = pool or StartPool()
    found: list[Candidate] = []
    for kind in usable_catalogue(state, catalogue).values():
        found += _best(_rigid(state, pool.likeliest(state, kind)))
        found += _best([_flexible(state, cover) for cover in kind.covers(state.model.context)])
    return sorted(found, key=lambda candidate: -candidate.gain)


def _best(candidates: Sequence[Candidate]) -> list[Candidate]:
    return [max(candidates, key=lambda candidate: candidate.gain)] if candidates else []


def change_of(state: FitState, effects: Sequence[CatalogueEffect]) -> Array:
    """Return what a set of effects changes in the whitened data residual (minus the residual's change).

    Raises:
        MeasurementError: If the prediction with them is not finite.
    """
    moved = state.predicted_with(effects)
    changed = state.comparison.residual(moved)
    if not np.isfinite(changed).all():
        names = ", ".join(effect.name for effect in effects)
        raise MeasurementError(f"the prediction with {names} is not finite; report this with the capture set")
    return np.asarray(state.plain_residual - changed)


def _rigid(state: FitState, starts: Sequence[CatalogueEffect]) -> list[Candidate]:
    if not starts:
        return []
    rows = state.comparison.size
    fit = state.fit
    changes = fit.followed(np.stack([change_of(state, (*state.effects, effect)) for effect in starts], axis=1))
    part = fit.half(fit.pull(changes))
    curvature = np.sum(changes**2, axis=0) - np.sum(part**2, axis=0)
    slope = changes.T @ fit.projected[:rows]
    floor = _SMALLEST_CURVATURE * np.maximum(np.sum(changes**2, axis=0), 1e-12)
    safe = np.maximum(curvature, floor)
    amplitude = np.clip(slope / safe, 0.0, _LARGEST_AMPLITUDE)
    free = np.array([bool(effect.free()) for effect in starts])
    amplitude = np.where(free, amplitude, 1.0)  # what has no amplitude acts as it is or not at all
    gain = np.where(curvature > floor, 2.0 * amplitude * slope - amplitude**2 * curvature, 0.0)
    return [
        Candidate(effect, float(g), max(len(effect.free()), 1)) for effect, g in zip(starts, gain.tolist(), strict=True)
    ]


def _flexible(state: FitState, cover: CatalogueEffect) -> Candidate:
    effects = (*state.effects, cover)
    parameters = EffectParameters.of(effects)
    own = [i for i, owner in enumerate(parameters.owner) if owner == len(state.effects)]
    at = change_of(state, effects)
    columns = [at]
    values = parameters.values
    for index in own:
        moved = values.copy()
        moved[index] += 0.1 * parameters.scale[index]
        columns.append(change_of(state, parameters.replaced(moved)) - at)
    rows = slice(0, state.comparison.size)
    gain, _ = state.fit.score(rows, state.fit.followed(np.stack(columns, axis=1)))
    return Candidate(cover, gain, len(own), flexible=True)
