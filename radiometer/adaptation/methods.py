"""Which level comes next, and when a threshold is found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.protocol import DownUpMethod, LimitsMethod, QuestPlusMethod, Spot, StaircaseMethod
from radiometer.errors import required_library

_SEEN: Final = {True: {"response": "seen"}, False: {"response": "unseen"}}


@dataclass
class QuestPlusSearch:
    """One threshold by QUEST+, on the package `questplus`.

    The psychometric function is a Weibull function of log10 luminance; its threshold is where the chance of an answer
    is 1 − 1/e (but for lapses and false alarms). The slope is a nuisance: it is marginalised out.

    Source: Watson 2017, QUEST+: a general multidimensional Bayesian adaptive psychometric method, J. Vision 17(3):10.
    """

    spot: Spot  # the spot's levels
    method: QuestPlusMethod  # its settings
    last: float | None = None  # threshold before, log10, on which the prior is centred; None for a flat prior
    threshold: float | None = None  # mean of the posterior, once its standard deviation is small enough
    exhausted: bool = False
    u_log10: float | None = None  # that standard deviation
    level: float = field(init=False)
    _levels: NDArray[np.float64] = field(init=False)
    _quest: Any = field(init=False)
    _answers: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        count = round((self.spot.highest_log10 - self.spot.lowest_log10) / self.method.step_log10) + 1
        self._levels = np.linspace(self.spot.lowest_log10, self.spot.highest_log10, count).round(6)
        self._quest = self._begun()
        self.level = float(self._quest.next_stim["intensity"])

    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""
        self._answers.append(seen)
        self._quest.update(stim={"intensity": self.level}, outcome=_SEEN[seen])
        chances = self._quest.marginal_posterior["threshold"]
        mean = float(chances @ self._levels)
        u_log10 = float(np.sqrt(chances @ (self._levels - mean) ** 2))
        known = u_log10 <= self.method.stop_sd_log10 and len(self._answers) >= self.method.least_blinks
        # Answers of one kind only bound a threshold from one side; what the prior adds is no measurement.
        if known and len(set(self._answers)) == 2:
            self.threshold, self.u_log10 = mean, u_log10
        elif len(self._answers) >= self.method.most_blinks:
            self.exhausted = True
        else:
            self.level = float(self._quest.next_stim["intensity"])

    def _begun(self) -> Any:
        questplus = required_library(
            "questplus",
            "method questplus needs the package of that name; install it with: pip install 'radiometer[eye]'",
        )
        prior = None
        if self.last is not None:
            away = (self._levels - self.last) / self.method.prior_sd_log10
            prior = {"threshold": np.exp(-0.5 * away**2)}
        return questplus.QuestPlus(
            stim_domain={"intensity": self._levels},
            param_domain={
                "threshold": self._levels,
                "slope": np.array(self.method.slopes),
                "lower_asymptote": np.array([self.method.false_alarms]),
                "lapse_rate": np.array([self.method.lapses]),
            },
            outcome_domain={"response": ["seen", "unseen"]},
            prior=prior,
            func="weibull",
            stim_scale="log10",
        )


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
