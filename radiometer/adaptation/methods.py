"""Which level comes next, and when a threshold is found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

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
class Ascent:
    """Ascending limits: up by a step per blink until it is seen; an ascent that is seen at once begins lower."""

    spot: Spot  # the spot's levels
    method: LimitsMethod  # its settings
    last: float | None = None  # threshold before, log10; None at the start, where the ascent begins near the top
    shift: float = 0.0  # part of a step, 0 to 1, by which it begins lower
    threshold: float | None = None
    exhausted: bool = False
    u_log10: float | None = None
    level: float = field(init=False)
    _missed: bool = False

    def __post_init__(self) -> None:
        below = self.method.start_below_log10 + self.shift * self.method.step_log10
        self.level = _start(self.spot, self.last, below)

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        if seen and self._missed:
            self.threshold = self.level
        elif seen and self.level <= self.spot.lowest_log10 + 1e-9:
            self.exhausted = True
        elif seen:
            self.level = max(self.level - self.method.start_below_log10, self.spot.lowest_log10)
        else:
            self._miss()

    def _miss(self) -> None:
        self._missed = True
        if self.level >= self.spot.highest_log10 - 1e-9:
            self.exhausted = True
        else:
            self.level = min(self.level + self.method.step_log10, self.spot.highest_log10)


@dataclass
class Staircase:
    """4-2 dB staircase: the mean of the last reversals is the threshold."""

    spot: Spot
    method: StaircaseMethod
    last: float | None = None
    shift: float = 0.0
    threshold: float | None = None
    exhausted: bool = False
    u_log10: float | None = None
    level: float = field(init=False)
    _turns: list[float] = field(default_factory=list)
    _went_up: bool | None = None

    def __post_init__(self) -> None:
        below = self.method.start_below_log10 + self.shift * self.method.step_log10
        self.level = _start(self.spot, self.last, below)

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
        end = self.spot.highest_log10 if up else self.spot.lowest_log10
        if abs(self.level - end) < 1e-9:
            self.exhausted = True
            return
        step = self.method.step_log10 if self._turns else self.method.first_step_log10
        moved = self.level + step if up else self.level - step
        self.level = min(max(moved, self.spot.lowest_log10), self.spot.highest_log10)


@dataclass
class DownUp:
    """Down in big steps while it is seen, up in small ones until it is seen again: that level is the threshold."""

    spot: Spot
    method: DownUpMethod
    last: float | None = None
    shift: float = 0.0
    threshold: float | None = None
    exhausted: bool = False
    u_log10: float | None = None
    level: float = field(init=False)
    _rising: bool = False

    def __post_init__(self) -> None:
        below = self.shift * self.method.up_log10 - self.method.start_above_log10
        self.level = _start(self.spot, self.last, below)

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        if seen and self._rising:
            self.threshold = self.level
            return
        self._rising = self._rising or not seen
        end = self.spot.highest_log10 if self._rising else self.spot.lowest_log10
        if abs(self.level - end) < 1e-9:
            self.exhausted = True
            return
        moved = self.level + (self.method.up_log10 if self._rising else -self.method.down_log10)
        self.level = min(max(moved, self.spot.lowest_log10), self.spot.highest_log10)


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


def _start(spot: Spot, last: float | None, below: float) -> float:
    first = spot.highest_log10 - 1.0 if last is None else last - below
    return min(max(first, spot.lowest_log10), spot.highest_log10)
