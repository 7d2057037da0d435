"""Which level comes next, and when a threshold is found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from radiometer.adaptation.protocol import DownUpMethod, LimitsMethod, QuestPlusMethod, Spot, StaircaseMethod
from radiometer.adaptation.quest_plus import QuestPlusSearch


class Method(Protocol):
    """The search for one threshold."""

    level: float  # log10 level of the next blink
    threshold: float | None  # log10 threshold once it is found
    exhausted: bool  # whether the search ended without one
    u_log10: float | None  # standard uncertainty of the threshold; None where the method states none

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""


@dataclass
class Search:
    """What all searches have that step from level to level."""

    spot: Spot  # the spot's levels
    method: Any  # its settings
    last: float | None = None  # threshold before, log10; None at the start, where the search begins near the top
    shift: float = 0.0  # part of a step, 0 to 1, by which it begins lower
    threshold: float | None = None
    exhausted: bool = False
    u_log10: float | None = None
    level: float = field(init=False)

    def __post_init__(self) -> None:
        first = self.spot.highest_log10 - 1.0 if self.last is None else self.last - self._below()
        self.level = min(max(first, self.spot.lowest_log10), self.spot.highest_log10)

    def _below(self) -> float:
        """Return how far below the threshold before the search begins, in log10 units."""
        return float(self.method.start_below_log10 + self.shift * self.method.step_log10)

    def _step(self, by_log10: float) -> None:
        """Move the level; a search that stands at the end of the spot's levels is over."""
        end = self.spot.highest_log10 if by_log10 > 0 else self.spot.lowest_log10
        if abs(self.level - end) < 1e-9:
            self.exhausted = True
        else:
            self.level = min(max(self.level + by_log10, self.spot.lowest_log10), self.spot.highest_log10)


@dataclass
class Ascent(Search):
    """Ascending limits: up by a step per blink until it is seen; an ascent that is seen at once begins lower."""

    method: LimitsMethod
    _missed: bool = False

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        if seen and self._missed:
            self.threshold = self.level
        else:
            self._missed = self._missed or not seen
            self._step(-self.method.start_below_log10 if seen else self.method.step_log10)


@dataclass
class Staircase(Search):
    """4-2 dB staircase: the mean of the last reversals is the threshold."""

    method: StaircaseMethod
    _turns: list[float] = field(default_factory=list)
    _went_up: bool | None = None

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        up = not seen
        if self._went_up is not None and up != self._went_up:
            self._turns.append(self.level)
        self._went_up = up
        if len(self._turns) > self.method.reversals:
            kept = self._turns[1:]
            self.threshold = sum(kept) / len(kept)
            return
        step = self.method.step_log10 if self._turns else self.method.first_step_log10
        self._step(step if up else -step)


@dataclass
class DownUp(Search):
    """Down in big steps while it is seen, up in small ones until it is seen again: that level is the threshold."""

    method: DownUpMethod
    _rising: bool = False

    def _below(self) -> float:
        return self.shift * self.method.up_log10 - self.method.start_above_log10

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        if seen and self._rising:
            self.threshold = self.level
            return
        self._rising = self._rising or not seen
        self._step(self.method.up_log10 if self._rising else -self.method.down_log10)


AnyMethod = LimitsMethod | StaircaseMethod | DownUpMethod | QuestPlusMethod


def begin(spot: Spot, method: AnyMethod, last: float | None, shift: float = 0.0) -> Method:
    """Return the search for the next threshold, begun near the last one.

    Args:
        spot: The spot's levels.
        last: Threshold before, log10; None at the start.
        shift: Part of a step, 0 to 1, by which limits and staircase begin lower. By chance from threshold to threshold,
            it keeps them from lying on one grid of levels, where errors of neighbours go together.

    Raises:
        MissingLibrary: For QUEST+ without its library.
    """
    if isinstance(method, LimitsMethod):
        return Ascent(spot, method, last, shift)
    if isinstance(method, StaircaseMethod):
        return Staircase(spot, method, last, shift)
    if isinstance(method, DownUpMethod):
        return DownUp(spot, method, last, shift)
    return QuestPlusSearch(spot, method, last)
