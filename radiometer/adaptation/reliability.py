"""How far a subject's answers can be relied on: false alarms, lapses, and how often it did not look at the mark."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.event_journal import Event

BLANK: Final = "blank"
BRIGHT: Final = "bright"
BLIND_SPOT: Final = "blind_spot"
NAMES: Final = {"false_alarms": "False alarms", "lapses": "Lapses", "fixation_losses": "Fixation lost"}
MEANINGS: Final = {
    "false_alarms": "presses to blinks without a spot",
    "lapses": "spots ten times above threshold that were not answered",
    "fixation_losses": "looks away from the mark, by the light in the blind spot, false alarms and lapses taken out",
}
_DRAWS: Final = 40_000  # the ends of a 95 % interval repeat to about 1 % of its width
_TAILS: Final = (0.025, 0.975)  # of a 95 % interval


@dataclass(frozen=True, slots=True)
class Count:
    """How often something happened, of how many times it could have."""

    hits: int = 0
    of: int = 0

    def __str__(self) -> str:
        return f"{self.hits}/{self.of}"


@dataclass(frozen=True, slots=True)
class Rate:
    """A share with its 95 % interval."""

    value: float  # the share, 0 to 1
    low: float  # lower end
    high: float  # upper end
    count: Count  # what was counted

    def __str__(self) -> str:
        return f"{100 * self.value:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f} %, {self.count})"


@dataclass(frozen=True, slots=True)
class Reliability:
    """Counts of a run."""

    false_alarms: Count = field(default_factory=Count)  # blinks without a spot that were answered
    lapses: Count = field(default_factory=Count)  # spots far above the threshold that were not
    fixation: Count = field(default_factory=Count)  # lights in the blind spot that were answered

    @property
    def rates(self) -> dict[str, Rate]:
        """Return the shares of what was tried at all, by name.

        A press at the blind spot has p = f + (1 − f)·(1 − λ)·x, with f the share of false alarms, λ of lapses and x of
        looks away. Intervals by draws from the Beta distributions that Jeffreys' prior gives each count; where there
        was no lapse catch λ is taken as 0, which makes x the smaller.
        """
        found = {}
        rng = np.random.default_rng(0)
        alarms, lapses = self.false_alarms, self.lapses
        f, missed = _draws(alarms, rng), _draws(lapses, rng)
        for name, count, drawn in (("false_alarms", alarms, f), ("lapses", lapses, missed)):
            if count.of:
                found[name] = _rate(count.hits / count.of, drawn, count)
        if self.fixation.of:
            seen = self.fixation.hits / self.fixation.of
            best = _looks_away(np.array([seen]), np.array([_share(alarms)]), np.array([_share(lapses)]))[0]
            drawn = _looks_away(_draws(self.fixation, rng), f, missed)
            found["fixation_losses"] = _rate(float(best), drawn, self.fixation)
        return found

    def to_mapping(self) -> dict[str, dict[str, float]]:
        """Return the shares with their intervals and counts for programs."""
        return {
            name: {"share": r.value, "low": r.low, "high": r.high, "hits": r.count.hits, "of": r.count.of}
            for name, r in self.rates.items()
        }

    def facts(self) -> dict[str, str]:
        """Return the counts in the form of a table of thresholds; those of what was tried."""
        counts = {"false_alarms": self.false_alarms, "lapses": self.lapses, "seen_at_blind_spot": self.fixation}
        return {name: str(count) for name, count in counts.items() if count.of}

    @classmethod
    def of_facts(cls, facts: Mapping[str, str]) -> Reliability:
        """Return the counts that a table of thresholds states; none where it states none."""
        names = ("false_alarms", "lapses", "seen_at_blind_spot")
        return cls(*(_count(facts.get(name, "")) for name in names))

    @classmethod
    def of_trials(cls, events: Sequence[Event], fastest_press_s: float) -> Reliability:
        """Return the counts of a journal's events: blinks, each belonging to the trial that follows."""
        counts = {kind: [0, 0] for kind in (BLANK, BRIGHT, BLIND_SPOT)}
        for blink in events:
            kind = kind_of_catch(blink) if blink["kind"] == "blink" else None
            if kind is not None:
                answered = any(press >= fastest_press_s for press in blink["presses_s"])
                counts[kind][0] += not answered if kind == BRIGHT else answered
                counts[kind][1] += 1
        return cls(*(Count(*counts[kind]) for kind in (BLANK, BRIGHT, BLIND_SPOT)))


def kind_of_catch(blink: Event) -> str | None:
    """Return what kind of catch a blink belongs to; None for one of a search."""
    named = blink.get("of")
    return str(named) if named is not None else BLANK if blink["log10_level"] is None else None


def _looks_away(
    pressed: NDArray[np.float64], false_alarms: NDArray[np.float64], lapses: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.clip((pressed - false_alarms) / np.maximum((1 - false_alarms) * (1 - lapses), 1e-9), 0.0, 1.0)


def _share(count: Count) -> float:
    return count.hits / count.of if count.of else 0.0


def _draws(count: Count, rng: np.random.Generator) -> NDArray[np.float64]:
    if count.of == 0:
        return np.zeros(_DRAWS)
    return rng.beta(count.hits + 0.5, count.of - count.hits + 0.5, _DRAWS)


def _rate(value: float, drawn: NDArray[np.float64], count: Count) -> Rate:
    """Return a share with its interval; one that was never, or always, hit reaches to 0, or 1."""
    low, high = (float(end) for end in np.quantile(drawn, _TAILS))
    low, high = (0.0 if count.hits == 0 else low), (1.0 if count.hits == count.of else high)
    return Rate(value, min(low, value), max(high, value), count)


def _count(stated: str) -> Count:
    match = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*", stated)
    return Count(int(match.group(1)), int(match.group(2))) if match else Count()
