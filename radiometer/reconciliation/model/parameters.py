"""The fitted parameters of a set of effects as one vector, each in steps of its typical size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

_STEP: Final = 1e-3  # of the parameter's scale
_AT_BOUND: Final = 1e-9


@dataclass(frozen=True, slots=True)
class EffectParameters:
    """Names, scales and bounds of all fitted parameters."""

    effects: tuple[CatalogueEffect, ...]  # the effects
    owner: tuple[int, ...]  # position of the effect that each parameter belongs to
    names: tuple[str, ...]  # its name
    scale: Array  # its typical size
    low: Array  # its lowest value
    high: Array  # its highest value

    @classmethod
    def of(cls, effects: Sequence[CatalogueEffect], full_scale_dn: float) -> EffectParameters:
        """Return the fitted parameters of effects, bounds in digital numbers being those of a camera's full scale."""
        owner, names, scale, low, high = [], [], [], [], []
        for index, effect in enumerate(effects):
            for name in effect.free():
                owner.append(index)
                names.append(name)
                plain = name.split("[")[0]
                scale.append(max(abs(value_of(effect, name)), 0.1 * _typical(effect, plain), 1e-12))
                lowest, highest = effect.reach(plain, full_scale_dn)
                low.append(lowest)
                high.append(highest)
        return cls(tuple(effects), tuple(owner), tuple(names), np.array(scale), np.array(low), np.array(high))

    @property
    def size(self) -> int:
        """Return the number of parameters."""
        return len(self.names)

    @property
    def values(self) -> Array:
        """Return their values in their own units."""
        return np.array([value_of(self.effects[o], n) for o, n in zip(self.owner, self.names, strict=True)])

    def moved(self, scaled_step: Array) -> tuple[tuple[CatalogueEffect, ...], tuple[int, ...]]:
        """Return the effects after a step in units of the scales, and which parameters were stopped by a bound."""
        proposed = self.values + scaled_step * self.scale if self.size else self.values
        kept = np.clip(proposed, self.low, self.high) if self.size else proposed
        stopped = tuple(i for i in range(self.size) if abs(kept[i] - proposed[i]) > _AT_BOUND * self.scale[i])
        return self.replaced(kept), stopped

    def on_bounds(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which parameters stand on their lower and which on their upper bound."""
        span = _AT_BOUND * self.scale
        return self.values - self.low <= span, self.high - self.values <= span

    def replaced(self, values: Array) -> tuple[CatalogueEffect, ...]:
        """Return the effects with these parameter values."""
        changes: list[dict[str, Any]] = [{} for _ in self.effects]
        for owner, name, value in zip(self.owner, self.names, values.tolist(), strict=True):
            plain, _, place = name.partition("[")
            if not place:
                changes[owner][plain] = value
                continue
            table = list(changes[owner].get(plain, getattr(self.effects[owner], plain)))
            table[int(place[:-1])] = value
            changes[owner][plain] = tuple(table)
        return tuple(_changed(e, c) for e, c in zip(self.effects, changes, strict=True))

    def of_effect(self, place: int) -> list[int]:
        """Return the positions of the parameters of one effect."""
        return [index for index, owner in enumerate(self.owner) if owner == place]

    def a_step_away(
        self, share: float = _STEP, only: Sequence[int] | None = None
    ) -> tuple[Array, list[tuple[CatalogueEffect, ...]]]:
        """Return a step of each parameter in units of the scales, within the bounds, and the effects after it.

        Args:
            only: Positions of the parameters that are moved; by default all are.
        """
        index = np.arange(self.size) if only is None else np.array(only, dtype=np.intp)
        values, scale = self.values, self.scale[index]
        steps = np.where(values[index] + share * scale <= self.high[index], share, -share)
        moved = np.tile(values, (index.size, 1))
        moved[np.arange(index.size), index] += steps * scale
        return steps, [self.replaced(one) for one in moved]


def _changed(effect: CatalogueEffect, values: dict[str, Any]) -> CatalogueEffect:
    """Return the effect with other values; the same object where nothing changes."""
    if all(getattr(effect, name) == value for name, value in values.items()):
        return effect
    return effect.with_parameters(**values)


def value_of(effect: CatalogueEffect, name: str) -> float:
    """Return a parameter's value; `name[2]` is the third entry of a table."""
    plain, _, place = name.partition("[")
    value = getattr(effect, plain)
    return float(value[int(place[:-1])] if place else value)


def _typical(effect: CatalogueEffect, name: str) -> float:
    """Return a parameter's typical size: the largest among the trials, else its usual value, else 1 %."""
    tried = [abs(trial[name]) for trial in effect.trials if name in trial]
    usual = {entry.name: entry.default for entry in fields(effect)}.get(name)
    return max(tried, default=abs(usual) if isinstance(usual, float) and usual else 0.01)
