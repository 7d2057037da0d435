"""What these data would have shown: the amplitude of every entry that stands out by five sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.reconcile.fit.state import FitState, with_effects
from radiometer.reconcile.result import Limit
from radiometer.reconcile.search.screening import AT_ONCE, changes_of
from radiometer.reconcile.statistics import partly_at_the_top
from simulators.effects.catalogue import CatalogueEffect

SIGMAS: Final = 5.0
_BLIND: Final = 1e-6  # share of a change that must survive the nuisances
_LARGEST_FACTOR: Final = 50.0  # times the typical size, beyond which the effect would be absurd
_LOOKS: Final = 12
_STRIDE: Final = 30.0  # largest factor from one look to the next
_CLOSE: Final = 0.1  # of ln χ²
_NOTHING: Final = 1e-6  # a χ² that stands for none
_ABSOLUTE_LIGHT: Final = "W m-2"  # has no scale where no radiance is known: the responsivity takes any


def limits(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, Limit]:
    """Return the amplitude of every entry that these data would have shown at five sigma, by name."""
    found = {name: Limit(None, *_main_parameter(kind, None)) for name, kind in sorted(catalogue.items())}
    asked = {name: kind for name, kind in catalogue.items() if _can_show(state, kind, found[name].unit)}
    present = {effect.name for effect in state.effects if effect.name in asked}
    starts = [_few(kind.starts(state.model.context)) for name, kind in asked.items() if name not in present]
    found |= _mildest(state, [start for several in starts for start in several])
    for name in sorted(present):  # what is named already: how small could it have been?
        others = with_effects(state, [effect for effect in state.effects if effect.name != name])
        named = _mildest(others, [effect for effect in state.effects if effect.name == name])
        # Further terms that stay while the size shrinks may show at any size: then the plain form tells.
        found |= named or _mildest(others, _few(asked[name].starts(state.model.context)))
    return found


def _can_show(state: FitState, kind: type[CatalogueEffect], unit: str) -> bool:
    if kind.saturates == "sharply" and partly_at_the_top(state.design, state.seen, state.prediction).any():
        return False  # the very tiles that would show it are left out, wherever it lies
    return kind.usable(state.model.context) and (unit != _ABSOLUTE_LIGHT or state.design.has_known_radiance)


def _few(starts: tuple[CatalogueEffect, ...]) -> tuple[CatalogueEffect, ...]:
    """Return a few starts spread over all: the smallest and some others."""
    step = max(1, len(starts) // 6)
    return starts[::step]


def _mildest(state: FitState, starts: Sequence[CatalogueEffect]) -> dict[str, Limit]:
    """Return the mildest limit of the starts of each entry, by name; none where no start has one.

    All starts take one look after the other side by side: what many change is projected at once.
    """
    found: dict[str, _Grown] = {}
    searches = [_Search(abs(near.size), near) for near in _grown(state, starts) if near.information > 0 and near.size]
    for _ in range(_LOOKS):
        for near in (search.near for search in searches if search.near.is_limit):
            found[near.effect.name] = near.milder(found.get(near.effect.name))
        going = [search.narrowed() for search in searches if search.near.grows and not search.near.is_limit]
        looks = [(search, search.next_look()) for search in going if not search.is_beyond(found)]
        wanted = [(search, effect) for search, effect in looks if effect is not None]
        grown = _grown(state, [effect for _, effect in wanted])
        searches = [replace(search, near=near) for (search, _), near in zip(wanted, grown, strict=True)]
    return {name: near.limit for name, near in found.items()}


@dataclass(frozen=True, eq=False)
class _Grown:
    """An effect at one size, and the χ² by which it would stand out there.

    Attributes:
        effect: The effect.
        parameter: The parameter that is its size.
        unit: Its unit.
        information: χ² that it would bring, all nuisances and other effects following.
    """

    effect: CatalogueEffect
    parameter: str
    unit: str
    information: float

    @property
    def size(self) -> float:
        """Return how far the parameter lies from doing nothing."""
        return _amplitude(self.effect, self.parameter)

    @property
    def grows(self) -> bool:
        """Tell whether it grows from nothing; if not, what counts is whether this very form would show."""
        jumps = self.effect.is_stepwise or bool(self.effect.saturates)
        return not jumps and self.parameter in self.effect.values()

    @property
    def is_limit(self) -> bool:
        """Tell whether it stands out by five sigma, or, where it does not grow, by as much at least."""
        if not self.grows:
            return self.information >= SIGMAS**2
        return bool(abs(np.log(max(self.information, _NOTHING) / SIGMAS**2)) < _CLOSE)

    @property
    def limit(self) -> Limit:
        """Return its size as a limit."""
        stated = self.effect.values()["reference_C"] if self.effect.heated else None
        return Limit(abs(self.size) if self.grows else self.size, self.parameter, self.unit, stated)

    def milder(self, other: _Grown | None) -> _Grown:
        """Return this or another limit, whichever is the milder effect."""
        if other is None:
            return self
        mildest = max if self.effect.saturates else min
        return mildest(other, self, key=lambda grown: abs(grown.size))

    def times(self, factor: float) -> CatalogueEffect | None:
        """Return the effect with its size times a factor; None beyond the parameter's bounds."""
        known = next(entry for entry in self.effect.parameters() if entry.name == self.parameter)
        values, neutral = self.effect.values()[self.parameter], self.effect.neutral(self.parameter)
        table = isinstance(values, tuple)
        old = np.atleast_1d(np.asarray(values, dtype=np.float64))
        new = neutral + factor * (old - neutral)
        if not np.all((known.low <= new) & (new <= known.high)) or np.array_equal(old, new):
            return None
        grown = tuple(new.tolist()) if table else float(new[0])
        return self.effect.with_parameters(**{self.parameter: grown})


@dataclass(frozen=True, eq=False)
class _Search:
    """The way to the size of five sigma, looked for where the effect has that size: few grow in proportion.

    Attributes:
        first: Size of the start.
        near: The last look.
        below: The last look that did not show.
        above: The last one that did.
    """

    first: float
    near: _Grown
    below: _Grown | None = None
    above: _Grown | None = None

    def narrowed(self) -> _Search:
        """Return the search with the last look as one of its ends."""
        shows = self.near.information > SIGMAS**2
        return replace(self, above=self.near) if shows else replace(self, below=self.near)

    def is_beyond(self, found: Mapping[str, _Grown]) -> bool:
        """Tell whether a milder form of the entry is known to show already than this one, which does not."""
        least = found.get(self.near.effect.name)
        return least is not None and self.below is not None and abs(self.below.size) >= abs(least.size)

    def next_look(self) -> CatalogueEffect | None:
        """Return the effect where to look next; None where it would be absurd."""
        size = _next_size(self.below, self.above)
        if not self.near.size or abs(size) > _LARGEST_FACTOR * self.first:  # it shows without any size, or never
            return None
        return self.near.times(size / self.near.size)


def _next_size(below: _Grown | None, above: _Grown | None) -> float:
    """Return where to look next for five sigma: between the two sizes in logarithms, or further on from one."""
    if below is None or above is None:
        known = below or above
        assert known is not None
        power = 0.25 if known.effect.acts_by_square else 0.5
        factor = (SIGMAS**2 / max(known.information, _NOTHING)) ** power
        return known.size * float(np.clip(factor * (0.9 if below is None else 1.1), 1.0 / _STRIDE, _STRIDE))
    low, high = (np.log(max(grown.information, _NOTHING) / SIGMAS**2) for grown in (below, above))
    share = float(np.clip(-low / (high - low), 0.1, 0.9))
    return float(below.size * (above.size / below.size) ** share)


def _grown(state: FitState, effects: Sequence[CatalogueEffect]) -> list[_Grown]:
    found = []
    for first in range(0, len(effects), AT_ONCE):
        batch = effects[first : first + AT_ONCE]
        for effect, information in zip(batch, _information(state, batch), strict=True):
            found.append(_Grown(effect, *_main_parameter(type(effect), effect), information))
    return found


def _information(state: FitState, effects: Sequence[CatalogueEffect]) -> list[float]:
    changes, part = state.fit.followed_with_half(changes_of(state, effects))
    whole = np.einsum("ij,ij->j", changes, changes)
    left = whole - np.einsum("ij,ij->j", part, part)
    return [float(value) for value in np.where(left > np.maximum(_BLIND * whole, 0.0), left, 0.0)]


def _main_parameter(kind: type[CatalogueEffect], start: CatalogueEffect | None) -> tuple[str, str]:
    names = start.free() if start is not None else kind.fitted
    known = {entry.name: entry.unit for entry in kind.parameters()}
    name = names[0].split("[")[0] if names else kind.profiled or next(iter(known), "share")
    return name, known.get(name, "1")


def _amplitude(effect: CatalogueEffect, name: str) -> float:
    """Return how far a parameter lies from doing nothing; of a table, its largest entry."""
    if name not in effect.values():
        return 1.0
    values = np.atleast_1d(np.asarray(effect.values()[name], dtype=np.float64)) - effect.neutral(name)
    return float(values[np.argmax(np.abs(values))])
