"""Runs a test: bleach, then one threshold after the other, everything journalled; can be taken up after a crash."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

import numpy as np

from radiometer.adaptation.journal import FORMAT, Event, Journal
from radiometer.adaptation.methods import begin
from radiometer.adaptation.protocol import AdaptationProtocol, SteadyBleach
from radiometer.errors import InputError, MeasurementError, UsageError


class Stage(Protocol):
    """The devices in front of the subject, on one clock."""

    def now_s(self) -> float:
        """Return the time in s since the stage was set up."""
        ...

    def room_luminance_cd_m2(self) -> float | None:
        """Return the luminance of the dark room; None where it cannot be measured."""
        ...

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Give the bleach and return when it is over. Raises DeviceError, UnsafeStimulus."""
        ...

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Show one blink (None: none, a catch) and return the presses during it in s from its onset."""
        ...

    def wait(self, seconds: float) -> None:
        """Let time pass in the dark; presses then count for nothing."""
        ...

    def resume_at(self, time_s: float) -> None:
        """Count on from a time, after a crash."""
        ...


class Verdict(StrEnum):
    """How a run ended."""

    COMPLETE = "complete"
    CRITERION_REACHED = "criterion_reached"
    NO_RESPONSE = "no_response"
    LEFT = "left"
    UNRELIABLE = "unreliable"


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a run.

    Attributes:
        verdict: In one word.
        explanation: For the user, what it means.
        times_min: Time of each threshold in min after the end of the bleach.
        thresholds_log10: Thresholds, log10 of scotopic cd·m⁻².
        false_presses: Presses to catches or faster than a human can.
        catches: Catches shown.
    """

    verdict: Verdict
    explanation: str
    times_min: tuple[float, ...]
    thresholds_log10: tuple[float, ...]
    false_presses: int
    catches: int

    @property
    def can_be_fitted(self) -> bool:
        """Tell whether the thresholds are a subject's."""
        return self.verdict in (Verdict.COMPLETE, Verdict.CRITERION_REACHED)

    def to_csv(self) -> str:
        """Return the columns time (min) and log10 threshold."""
        rows = [f"{t:.5f},{v:.4f}" for t, v in zip(self.times_min, self.thresholds_log10, strict=True)]
        return "\n".join(["time_min,log10_threshold", *rows]) + "\n"


Watcher = Callable[[Event], None]


def run_test(
    protocol: AdaptationProtocol,
    stage: Stage,
    journal: Journal,
    *,
    subject: str,
    seed: int = 0,
    watch: Watcher = lambda event: None,
) -> Outcome:
    """Run a test from the beginning, or from where its journal ends.

    Args:
        protocol: What is done.
        stage: The devices.
        journal: An open journal; events in it are not done again.
        subject: Pseudonym of the subject.
        seed: Seed of the catches.
        watch: Told every new event.

    Raises:
        UsageError: If the journal is of another subject or protocol.
        MeasurementError: If the room is not dark.
        DeviceError: If a device fails; the run can be taken up again.
    """
    run = _Run(protocol, stage, journal, subject, seed, watch)
    run.start()
    while (outcome := run.finished()) is None:
        run.trial()
    if not journal.of_kind("end"):
        run.note("end", verdict=str(outcome.verdict), explanation=outcome.explanation)
    return outcome


@dataclass(slots=True)
class _Run:
    protocol: AdaptationProtocol
    stage: Stage
    journal: Journal
    subject: str
    seed: int
    watch: Watcher

    def note(self, kind: str, **facts: Any) -> Event:
        event = self.journal.write(kind, self.stage.now_s(), **facts)
        self.watch(event)
        return event

    def start(self) -> None:
        """Begin anew, or check that the journal is this test's and set the clock to its end."""
        if not self.journal.events:
            self.note("start", format=FORMAT, subject=self.subject, protocol=self.protocol.name, seed=self.seed)
        begun = self.journal.events[0]
        for key, mine in (("subject", self.subject), ("protocol", self.protocol.name), ("seed", self.seed)):
            if begun.get(key) != mine:
                raise UsageError(
                    f"{self.journal.path}: belongs to {key} {begun.get(key)!r}, not {mine!r}; name another journal"
                )
        if not self.journal.of_kind("dark"):
            self._prepare()
        self.stage.resume_at(float(self.journal.events[-1]["time_s"]))

    def _prepare(self) -> None:
        room, limit = self.stage.room_luminance_cd_m2(), self.protocol.safety.darkest_room_cd_m2
        if room is not None and room > limit:
            raise MeasurementError(f"the room has {room:.2g} cd/m²; the test needs less than {limit:.2g}: darken it")
        self.note("room", luminance_cd_m2=room)
        bleach = self.protocol.bleach
        self.note("bleach", light=bleach.model_dump())
        self.stage.bleach(self.protocol)
        self.note("dark", steady=isinstance(bleach, SteadyBleach))

    @property
    def _dark_since_s(self) -> float:
        return float(self.journal.of_kind("dark")[0]["time_s"])

    def trial(self) -> None:
        """Find one threshold, or give a catch, and journal it."""
        number = len(self.journal.of_kind("trial"))
        rng = np.random.default_rng([self.seed, number])
        # The pause stands before the trial, so that a run taken up after a crash keeps the same times.
        self.stage.wait(self.protocol.watch.pause_between_s if number else 0.0)
        if rng.random() < self.protocol.watch.catch_share:
            self._catch(number, rng)
        else:
            self._threshold(number)

    def _catch(self, number: int, rng: np.random.Generator) -> None:
        blinks = int(rng.integers(2, 5))
        presses = [p for n in range(blinks) for p in self.stage.blink(None, number, n)]
        self.note("trial", catch=True, false_press=bool(presses), threshold=None)

    def _threshold(self, number: int) -> None:
        search = begin(self.protocol.spot, self.protocol.method, self._last())
        blinks, hasty = 0, False
        begun_s = self.stage.now_s()
        while search.threshold is None and not search.exhausted:
            presses = self.stage.blink(search.level, number, blinks)
            blinks += 1
            hasty = any(p < self.protocol.watch.fastest_press_s for p in presses)
            if hasty:
                break
            search.answer(seen=bool(presses))
        self.note(
            "trial",
            catch=False,
            false_press=hasty,
            threshold=None if search.threshold is None else round(search.threshold, 4),
            minutes=round((0.5 * (begun_s + self.stage.now_s()) - self._dark_since_s) / 60, 5),
            blinks=blinks,
        )

    def _last(self) -> float | None:
        found = [e["threshold"] for e in self.journal.of_kind("trial") if e["threshold"] is not None]
        return float(found[-1]) if found else None

    def finished(self) -> Outcome | None:
        """Return the outcome if the test is over."""
        trials = self.journal.of_kind("trial")
        tries = [t for t in trials if not t["catch"]]
        absent = self.protocol.watch.absent_after
        gone = len(tries) >= absent and all(t["threshold"] is None and not t["false_press"] for t in tries[-absent:])
        if gone:
            answered = any(t["threshold"] is not None for t in tries)
            return outcome_of(self.journal, Verdict.LEFT if answered else Verdict.NO_RESPONSE, self.protocol)
        criterion, last = self.protocol.end.criterion_log10, self._last()
        if criterion is not None and last is not None and last <= criterion:
            return outcome_of(self.journal, Verdict.CRITERION_REACHED, self.protocol)
        if self.stage.now_s() - self._dark_since_s >= 60 * self.protocol.end.duration_min:
            return outcome_of(self.journal, Verdict.COMPLETE, self.protocol)
        return None


_EXPLANATIONS = {
    Verdict.COMPLETE: "the test ran its whole time",
    Verdict.CRITERION_REACHED: "the threshold fell below the protocol's criterion",
    Verdict.NO_RESPONSE: "the button was never pressed: no threshold is known, nothing is fitted",
    Verdict.LEFT: "presses stopped: the subject left or fell asleep; nothing is fitted",
    Verdict.UNRELIABLE: "the button was pressed without a light too often: thresholds mean nothing, nothing is fitted",
}


def outcome_of(journal: Journal, verdict: Verdict, protocol: AdaptationProtocol) -> Outcome:
    """Return the outcome of a journal's trials; too many false presses overrule any other verdict.

    Raises:
        InputError: If the journal holds no start.
    """
    if not journal.events:
        raise InputError(f"{journal.path}: holds no test")
    trials = journal.of_kind("trial")
    false, catches = sum(bool(t["false_press"]) for t in trials), sum(bool(t["catch"]) for t in trials)
    hasty = sum(bool(t["false_press"]) and not t["catch"] for t in trials)
    caught = false - hasty
    limit = protocol.watch.most_false_share
    if (catches and caught / catches > limit and caught > 1) or (trials and hasty / len(trials) > limit):
        verdict = Verdict.UNRELIABLE
    found = [t for t in trials if t["threshold"] is not None]
    return Outcome(
        verdict,
        _EXPLANATIONS[verdict],
        tuple(float(t["minutes"]) for t in found),
        tuple(float(t["threshold"]) for t in found),
        false,
        catches,
    )
