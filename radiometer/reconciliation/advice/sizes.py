"""The size at which an entry stands out by so much, looked for where it has that size: few grow in proportion.

A limit of what pixels hold, a step of codes or a rounded print does not grow from nothing at all: of these the mildest
form counts that stands out by so much at least.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.result import Limit
from radiometer.reconciliation.search.screening import AT_ONCE, changes_where_possible
from radiometer.reconciliation.statistics import partly_at_the_top
from simulators.effects.catalogue import CatalogueEffect

SHOWN: Final = 5.0**2  # χ² of what stands out: five sigma
_BLIND: Final = 1e-6  # share of a change that must survive the nuisances
_LOOKS: Final = 12
_STRIDE: Final = 30.0  # largest factor from one look to the next
_CLOSE: Final = 0.1  # of ln χ²
_NOTHING: Final = 1e-6  # a χ² that stands for none


@dataclass(frozen=True, slots=True)
class Asked:
    """The detection that is asked for."""

    chi2: float  # χ² by which an effect is to stand out, all nuisances and other effects following
    largest_factor: float  # times the size of its start, beyond which it would be absurd


def mildest(state: FitState, starts: Sequence[CatalogueEffect], asked: Asked) -> dict[str, Grown]:
    """Return the mildest form of each entry that stands out by so much, by name; none where no start has one.

    All starts take one look after the other side by side: what many change is projected at once.

    Args:
        starts: Starts of any entries.
        asked: By how much they are to stand out.
    """
    found: dict[str, Grown] = {}
    looks = grown(state, starts, asked)
    searches = [_Search(abs(near.size), near) for near in looks if near.information > 0 and near.size]
    for _ in range(_LOOKS):
        for near in (search.near for search in searches if search.near.is_limit):
            found[near.effect.name] = near.milder(found.get(near.effect.name))
        going = [search.narrowed() for search in searches if search.near.grows and not search.near.is_limit]
        further = [(search, search.next_look()) for search in going if not search.is_beyond(found)]
        searched = [(search, effect) for search, effect in further if effect is not None]
        looks = grown(state, [effect for _, effect in searched], asked)
        searches = [replace(search, near=near) for (search, _), near in zip(searched, looks, strict=True)]
    return found


def grown(state: FitState, effects: Sequence[CatalogueEffect], asked: Asked) -> list[Grown]:
    """Return effects as they are, with the χ² by which each alone stands out.

    Args:
        effects: Any effects.
        asked: By how much they are to stand out.
    """
    found = []
    for first in range(0, len(effects), AT_ONCE):
        batch = effects[first : first + AT_ONCE]
        for effect, information in zip(batch, _information(state, batch), strict=True):
            found.append(Grown(effect, *main_parameter(type(effect), effect), information, asked))
    return found


@dataclass(frozen=True, eq=False)
class Grown:
    """An effect at one size, and the χ² by which it would stand out there."""

    effect: CatalogueEffect  # the effect
    parameter: str  # the parameter that is its size
    unit: str  # its unit
    information: float  # χ² that it would bring, all nuisances and other effects following
    asked: Asked  # the χ² that it is to bring

    @property
    def size(self) -> float:
        """Return the distance of the parameter from the value without effect."""
        return _amplitude(self.effect, self.parameter)

    @property
    def grows(self) -> bool:
        """Return whether it grows from nothing; if not, what counts is whether this very form would show."""
        return self.effect.grows and self.parameter in self.effect.values()

    @property
    def is_limit(self) -> bool:
        """Return whether it stands out by what is asked, or, where it does not grow, by as much at least."""
        if not self.grows:
            return self.information >= self.asked.chi2
        return bool(abs(np.log(max(self.information, _NOTHING) / self.asked.chi2)) < _CLOSE)

    def milder(self, other: Grown | None) -> Grown:
        """Return this or another limit, whichever is the milder effect."""
        if other is None:
            return self
        choose = max if self.effect.saturates else min
        return choose(other, self, key=lambda one: abs(one.size))

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
    """Search for the size that is asked for."""

    first: float  # size of the start
    near: Grown  # the last look
    below: Grown | None = None  # the last look that did not show
    above: Grown | None = None  # the last one that did

    def narrowed(self) -> _Search:
        """Return the search with the last look as one of its ends."""
        shows = self.near.information > self.near.asked.chi2
        return replace(self, above=self.near) if shows else replace(self, below=self.near)

    def is_beyond(self, found: Mapping[str, Grown]) -> bool:
        """Return whether a milder form of the entry is known to show already than this one, which does not."""
        least = found.get(self.near.effect.name)
        return least is not None and self.below is not None and abs(self.below.size) >= abs(least.size)

    def next_look(self) -> CatalogueEffect | None:
        """Return the effect where to look next; None where it would be absurd."""
        size, asked = _next_size(self.below, self.above), self.near.asked
        if not self.near.size or abs(size) > asked.largest_factor * self.first:  # it shows without any size, or never
            return None
        return self.near.times(size / self.near.size)


def _next_size(below: Grown | None, above: Grown | None) -> float:
    """Return where to look next: between the two sizes in logarithms, or further on from one."""
    if below is None or above is None:
        known = below or above
        assert known is not None
        power = 0.25 if known.effect.acts_by_square else 0.5
        factor = (known.asked.chi2 / max(known.information, _NOTHING)) ** power
        return known.size * float(np.clip(factor * (0.9 if below is None else 1.1), 1.0 / _STRIDE, _STRIDE))
    low, high = (np.log(max(look.information, _NOTHING) / look.asked.chi2) for look in (below, above))
    share = float(np.clip(-low / (high - low), 0.1, 0.9))
    return float(below.size * (above.size / below.size) ** share)


def _information(state: FitState, effects: Sequence[CatalogueEffect]) -> list[float]:
    several = [(*state.effects, effect) for effect in effects]
    moved = np.nan_to_num(changes_where_possible(state, several))  # what no camera does shows nothing
    changes, part = state.fit.followed_with_half(moved)
    whole = np.einsum("ij,ij->j", changes, changes)
    left = whole - np.einsum("ij,ij->j", part, part)
    return [float(value) for value in np.where(left > np.maximum(_BLIND * whole, 0.0), left, 0.0)]


def main_parameter(kind: type[CatalogueEffect], start: CatalogueEffect | None) -> tuple[str, str]:
    """Return the parameter that is an entry's size, and its unit.

    Args:
        start: One form of it; None for the usual one.
    """
    names = start.free() if start is not None else kind.fitted
    known = {entry.name: entry.unit for entry in kind.parameters()}
    name = names[0].split("[")[0] if names else kind.profiled or next(iter(known), "share")
    return name, known.get(name, "1")


def _amplitude(effect: CatalogueEffect, name: str) -> float:
    """Return the distance of a parameter from the value without effect; of a table, its largest entry."""
    if name not in effect.values():
        return 1.0
    values = np.atleast_1d(np.asarray(effect.values()[name], dtype=np.float64)) - effect.neutral(name)
    return float(values[np.argmax(np.abs(values))])


_LARGEST_FACTOR: Final = 50.0  # times the typical size, beyond which the effect would be absurd
_ASKED: Final = Asked(SHOWN, _LARGEST_FACTOR)
_ABSOLUTE_LIGHT: Final = "W m-2"  # has no scale where no radiance is known: the responsivity takes any


def limits(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, Limit]:
    """Return the amplitude of every entry that these data would have shown at five sigma, by name."""
    found = {name: Limit(None, *main_parameter(kind, None)) for name, kind in sorted(catalogue.items())}
    asked = {name: kind for name, kind in catalogue.items() if _can_show(state, kind, found[name].unit)}
    present = {effect.name for effect in state.effects if effect.name in asked}
    starts = [_few(kind.starts(state.model.context)) for name, kind in asked.items() if name not in present]
    found |= _mildest(state, [start for several in starts for start in several])
    for name in sorted(present):  # what is named already: how small could it have been?
        others = with_effects(state, [effect for effect in state.effects if effect.name != name])
        named = _mildest(others, [effect for effect in state.effects if effect.name == name])
        # Further terms that stay while the size shrinks may show at any size: then the plain form decides.
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
    return {name: _limit(near) for name, near in mildest(state, starts, _ASKED).items()}


def _limit(near: Grown) -> Limit:
    """Return a size as a limit."""
    stated = near.effect.values()["reference_C"] if near.effect.heated else None
    return Limit(abs(near.size) if near.grows else near.size, near.parameter, near.unit, stated)
