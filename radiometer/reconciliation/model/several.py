"""Predicts what several models expect in one walk of the chain.

Models that are compared with one that ran before differ from it in one step, as a rule: a parameter that moved, an
effect more. Each runs only the steps in which it differs. Behind them all go on together, their moments stacked along
an axis in front of the captures: the arrays of one model are so small that calling NumPy costs more than arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Final, Self, TypeVar

import numpy as np

from radiometer.reconciliation.model.tile_model import Nuisance, TileModel, Trace, Walk, first_of, looks_back
from radiometer.reconciliation.prediction import Prediction
from radiometer.typing import Array
from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS
from simulators.effects.tile_moments import Moments

SomeMoments = TypeVar("SomeMoments", bound=Moments)
_AT_ONCE: Final = 1 << 16  # entries of a stacked array: more of them leave the processor's nearest memory


def predict_several(
    models: Sequence[tuple[TileModel, Nuisance]], like: Trace
) -> Iterator[tuple[list[int], Prediction]]:
    """Yield what models of the same captures expect: numbers of some, and their statistics along a first axis.

    Args:
        models: The models, which differ in their effects, and their nuisances.
        like: The chain as it ran for the same captures.
    """
    waiting = sorted((_Apart.of(n, *entry, like) for n, entry in enumerate(models)), key=lambda one: one.joins)
    most = max(1, _AT_ONCE // like.passed[0].mean.size)
    while waiting:
        together = _Together(models[0][0], like)
        left = together.walk_with(waiting[:most])
        yield [one.number for one in together.members], together.prediction()
        waiting = left + waiting[most:]


@dataclass(frozen=True, slots=True, eq=False)
class _Apart:
    """A model after the steps in which it differs.

    Attributes:
        number: Its number.
        model: The model.
        walk: The chain so far.
        joins: Number of the step of the known chain from which on it has no others.
    """

    number: int
    model: TileModel
    walk: Walk
    joins: int

    @classmethod
    def of(cls, number: int, model: TileModel, nuisance: Nuisance, like: Trace) -> Self:
        """Return a model just before the steps that it shares with a known chain."""
        walk = model.begun(nuisance, like)
        behind = zip(reversed(like.chain), reversed(walk.chain), strict=False)
        same = takewhile(lambda pair: pair[0] is pair[1] and not looks_back(pair[0]), behind)
        shared = min(sum(1 for _ in same), len(walk.chain) + 1 - len(walk.passed))
        return cls(number, model, model.walked(walk, len(walk.chain) - shared), len(like.chain) - shared)


class _Together:
    """Models that go through the rest of a known chain as one.

    Attributes:
        members: The models, in the order in which they joined.
    """

    def __init__(self, model: TileModel, like: Trace) -> None:
        self._model, self._like = model, like
        self._passed = list(like.passed)  # in front of the first that joins nothing of it is asked for
        self.members = list[_Apart]()

    def walk_with(self, waiting: Sequence[_Apart]) -> list[_Apart]:
        """Walk to the end of the chain with all that may join; return those that may not.

        Args:
            waiting: The models in the order in which they join.
        """
        left, chain = list[_Apart](), self._like.chain
        for number in range(waiting[0].joins, 1 + len(chain)):
            joining = [one for one in waiting if one.joins == number]
            if joining:
                left += self._join(joining, number)
            if number < len(chain):
                self._passed[number + 1] = self._model.through(chain[number], self._passed[number])
        return left

    def prediction(self) -> Prediction:
        """Return what the members expect."""
        known = self._like.prediction
        signal = self._of_members(1 + first_of(self._like.links, ELECTRONS), TileModel.signal, known.signal.shape)
        gain = self._of_members(first_of(self._like.links, DIGITAL_NUMBER), TileModel.gain, known.gain.shape)
        taken = np.array([[one.model.taken] for one in self.members])
        return self._model.summary(self._passed[-1], signal, taken * gain)

    def _join(self, joining: list[_Apart], number: int) -> list[_Apart]:
        """Put models into the stack in front of a step; return those that have other figures of a whole frame."""
        parts, counts = [one.walk.passed[-1] for one in joining], [1] * len(joining)
        if self.members:
            parts, counts = [self._passed[number], *parts], [len(self.members), *counts]
        fits = [_figures(part) == _figures(parts[0]) for part in parts]
        kept = [place for place, fit in enumerate(fits) if fit]
        self._passed[number] = stacked([parts[place] for place in kept], [counts[place] for place in kept])
        told = fits[-len(joining) :]
        self.members += [one for one, fit in zip(joining, told, strict=True) if fit]
        return [one for one, fit in zip(joining, told, strict=True) if not fit]

    def _of_members(self, place: int, of: Callable[[TileModel, Walk], Array], shape: tuple[int, ...]) -> Array:
        """Return something that walks show in front of a link: of those who had joined by then at once, of each else.

        Args:
            place: Position of the link.
            of: What is asked for.
            shape: Its shape for one model.
        """
        number, like = self._like.number(place), self._like
        late = [one for one in self.members if one.joins > number]
        found = [of(one.model, one.walk)[None] for one in late]
        if early := len(self.members) - len(late):
            walk = Walk(like.nuisance, like.taken, like.links, like.chain, tuple(self._passed))
            found = [np.broadcast_to(of(self._model, walk), (early, *shape)), *found]
        return np.concatenate(found)


def _figures(moments: Moments) -> tuple[Any, ...]:
    """Return what no array holds, and must be alike where moments are stacked."""
    return (moments.unrounded is None, *(getattr(moments, name) for name in moments.figures))


def stacked(parts: Sequence[SomeMoments], counts: Sequence[int]) -> SomeMoments:
    """Return moments of several models along a first axis; a field that all have in common stays as it is.

    The mean always has that axis, by which their number is known.

    Args:
        parts: Moments of one model each, or of several already.
        counts: How many.
    """
    first = parts[0]
    further = [part.unrounded for part in parts if part.unrounded]
    found: dict[str, Any] = {"unrounded": stacked(further, counts) if further else None}
    for name in vars(first).keys() - {"unrounded", *first.figures}:
        values = [getattr(part, name) for part in parts]
        if name == "mean" or any(value is not values[0] for value in values):
            found[name] = _stacked([np.asarray(value) for value in values], counts)
    return first.changed(**found)


def _stacked(values: Sequence[Array], counts: Sequence[int]) -> Array:
    shapes = {value.shape[-3:] for value in values}
    found, at = np.empty((sum(counts), *np.broadcast_shapes(*shapes, (1, 1, 1)))), 0
    for value, count in zip(values, counts, strict=True):
        found[at : at + count] = value
        at += count
    return found
