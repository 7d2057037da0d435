"""The journal of a test, how the run ended, and whether its thresholds are a subject's."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.data.event_journal import Event, EventJournal
from radiometer.data.json_text import json_text, parsed_json
from radiometer.errors import InputError

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


FORMAT: Final = "radiometer-adaptation/1"
REFUSED: Final = "refused"
CHECK: Final = "check"
DEVICE_FACTS: Final = ("box", "firmware", "screen", "calibrated")  # of a journal's `stage`, for the table and report


class RunJournal(EventJournal):
    """The journal of a test.

    Args:
        path: The file; created where it is not there.
        relive: Resume a simulated run by simulating it again. Events come anew from the first on (or from the last
            refused try on). They must equal those in the file, and are written where the file ends. A simulated world
            that died with its program is whole again then, down to the temperature of its LEDs.
    """

    path: Path

    def __init__(self, path: Path, *, relive: bool = False) -> None:
        super().__init__(path)
        known = self.events
        tried = max((number + 1 for number, event in enumerate(known) if event["kind"] == REFUSED), default=0)
        self._past: deque[Event] = deque(known[tried:] if relive else [])
        self.events = known[:tried] if relive else known

    def write(self, kind: str, time_s: float, *, lasting: bool = True, **facts: Any) -> Event:
        """Append an event and return it; of a run that is lived through again, the one that is in the file.

        Raises:
            OutputError: If the disk refuses it.
            InputError: If the run is lived through again and this event is another one than the file's.
        """
        if not self._past:
            return super().write(kind, time_s, lasting=lasting, **facts)
        before = self._past.popleft()
        self._compare({"sequence": len(self.events), "kind": kind, "time_s": round(time_s, 4), **facts}, before)
        self.events.append(before)
        return before

    def _compare(self, event: Event, before: Event) -> None:
        same = parsed_json(json_text(event)) == before
        if not same and not event["kind"] == before["kind"] == CHECK:  # a calibration has grown older meanwhile
            raise InputError(
                f"{self.path}, line {event['sequence'] + 1}: the simulated run is not the same any more "
                f"({before['kind']} then, {event['kind']} now); options or program have changed, name another journal"
            )

    @property
    def upcoming(self) -> Event | None:
        """Return the event that comes next in a run that is lived through again; None where the new begins."""
        return self._past[0] if self._past else None


class Verdict(StrEnum):
    """How a run ended."""

    COMPLETE = "complete"
    CRITERION_REACHED = "criterion_reached"
    FLOOR_REACHED = "floor_reached"
    NO_RESPONSE = "no_response"
    LEFT = "left"
    UNRELIABLE = "unreliable"
    FIXATION_LOST = "fixation_lost"
    STOPPED = "stopped"
    PRACTICE = "practice"


EXPLANATIONS: Final = {
    Verdict.COMPLETE: "the test ran its whole time",
    Verdict.CRITERION_REACHED: "the threshold fell below the protocol's criterion",
    Verdict.FLOOR_REACHED: "the dimmest level of the spot is seen every time: the curve is known down to it",
    Verdict.NO_RESPONSE: "the button was never pressed: no threshold is known, nothing is fitted",
    Verdict.LEFT: "presses stopped: the subject left or fell asleep; nothing is fitted",
    Verdict.UNRELIABLE: "the button was pressed without a light too often: the thresholds have no meaning; "
    "nothing is fitted",
    Verdict.FIXATION_LOST: "the light in the blind spot was seen too often: the subject did not look at the mark, so "
    "the place of the thresholds on the retina is unknown; nothing is fitted",
    Verdict.STOPPED: "the test was stopped before its end: its thresholds are kept, nothing is fitted",
    Verdict.PRACTICE: "a practice run without a bleach: nothing is fitted; begin the test once catches are not pressed "
    "and thresholds agree",
}


FITTED: Final = (Verdict.COMPLETE, Verdict.CRITERION_REACHED, Verdict.FLOOR_REACHED)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a run."""

    verdict: Verdict  # in one word
    explanation: str  # for the user, what it means
    times_min: tuple[float, ...]  # time of each threshold in min after the end of the bleach
    thresholds_log10: tuple[float, ...]  # thresholds, log10 of scotopic cd·m⁻²
    false_presses: int  # presses to catches or faster than a human can
    catches: int  # catches without a light shown
    u_log10: tuple[float, ...] = ()  # standard uncertainty of each threshold; empty where the method states none
    reliability: Reliability = field(default_factory=Reliability)  # False alarms, lapses and looks away from the mark

    @property
    def can_be_fitted(self) -> bool:
        """Return whether the thresholds are a subject's."""
        return self.verdict in FITTED

    def to_csv(self, facts: Mapping[str, str] | None = None) -> str:
        """Return the columns time (min), log10 threshold and, where it is known, its standard uncertainty.

        Args:
            facts: What stands before them, each in a line that begins with #.
        """
        names = ["time_min", "log10_threshold", *(["u_log10_threshold"] if self.u_log10 else [])]
        columns = [self.times_min, self.thresholds_log10, *([self.u_log10] if self.u_log10 else [])]
        rows = [",".join([f"{row[0]:.5f}", *(f"{v:.4f}" for v in row[1:])]) for row in zip(*columns, strict=True)]
        head = [f"# {name}: {value}" for name, value in (facts or {}).items()]
        return "\n".join([*head, ",".join(names), *rows]) + "\n"


def counting_trials(journal: RunJournal) -> list[Event]:
    """Return the trials that count: all but those whose press turned out to be the long one that asks for a pause."""
    void = {event["voids"] for event in journal.of_kind("pause")} - {None}
    return [trial for trial in journal.of_kind("trial") if trial["sequence"] not in void]


def devices_of(events: Iterable[Event]) -> dict[str, str]:
    """Return what a journal states of the devices, by name, for table and report."""
    stages = [event for event in events if event["kind"] == "stage"]
    return {name: str(one[name]) for one in stages for name in DEVICE_FACTS if one.get(name) is not None}


def outcome_of(journal: RunJournal, verdict: Verdict, protocol: AdaptationProtocol) -> Outcome:
    """Return the outcome of a journal's trials; too many false presses overrule any other verdict.

    Raises:
        InputError: If the journal holds no start.
    """
    if not journal.events:
        raise InputError(f"{journal.path}: holds no test")
    trials = counting_trials(journal)
    if too_many_false(trials, protocol):
        verdict = Verdict.UNRELIABLE
    reliability = Reliability.of_trials(journal.events, protocol.watch.fastest_press_s)
    if verdict in FITTED and _fixation_lost(reliability, protocol):
        verdict = Verdict.FIXATION_LOST
    found = [t for t in trials if t["threshold"] is not None]
    return Outcome(
        verdict,
        EXPLANATIONS[verdict],
        tuple(float(t["minutes"]) for t in found),
        tuple(float(t["threshold"]) for t in found),
        sum(bool(t["false_press"]) for t in trials),
        sum(_is_blank(t) for t in trials),
        tuple(float(t["u_log10"]) for t in found if t.get("u_log10") is not None),
        reliability,
    )


def _fixation_lost(reliability: Reliability, protocol: AdaptationProtocol) -> bool:
    """Return whether the subject certainly looked away from the mark more often than the protocol allows."""
    check, found = protocol.fixation_check, reliability.rates.get("fixation_losses")
    return check is not None and found is not None and found.low > check.most_lost_share


def _is_blank(trial: Event) -> bool:
    return bool(trial["catch"]) and trial.get("of", BLANK) == BLANK


def too_many_false(trials: list[Event], protocol: AdaptationProtocol) -> bool:
    """Return whether a larger share than the protocol allows of the catches, or of all trials, had false presses."""
    catches = [t for t in trials if _is_blank(t)]
    caught = sum(bool(t["false_press"]) for t in catches)
    hasty = sum(bool(t["false_press"]) for t in trials) - caught
    limit = protocol.watch.most_false_share
    return (caught > 1 and caught / len(catches) > limit) or (bool(trials) and hasty / len(trials) > limit)
