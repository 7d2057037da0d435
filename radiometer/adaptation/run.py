"""Runs a test: bleach, then one threshold after the other, everything journalled; can be taken up after a crash.

Events of the journal, in this order. First `start`, `stage` (what the devices are, where they report it), `check`,
`room`, `refused` (by a check), `bleach`, `dark`. Then `blink` (after each blink, with its presses) and `trial` (after
each threshold or catch). Between them `pause`, `resume`, `taken_up` (after a crash), `fixation` (it was lost) and
`prompt` (a sound). At last `stop` and `end`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.checks import Check
from radiometer.adaptation.outcome import (
    BLANK,
    BLIND_SPOT,
    BRIGHT,
    FORMAT,
    REFUSED,
    Outcome,
    RunJournal,
    Verdict,
    counting_trials,
    kind_of_catch,
    outcome_of,
    too_many_false,
)
from radiometer.adaptation.protocol import (
    AdaptationProtocol,
    DownUpMethod,
    LimitsMethod,
    QuestPlusMethod,
    Spot,
    StaircaseMethod,
    SteadyBleach,
)
from radiometer.adaptation.request import Controls
from radiometer.adaptation.run_facts import facts_of
from radiometer.data.event_journal import START, Event
from radiometer.errors import UsageError, required_library

_SEEN: Final = {True: {"response": "seen"}, False: {"response": "unseen"}}


@dataclass
class Search(ABC):
    """The search for one threshold; where it steps from level to level, how."""

    spot: Spot  # the spot's levels
    method: Any  # its settings
    last: float | None = None  # threshold before, log10; None at the start, where the search begins near the top
    shift: float = 0.0  # part of a step, 0 to 1, by which it begins lower
    threshold: float | None = None  # log10 threshold once it is found
    exhausted: bool = False  # whether the search ended without one
    u_log10: float | None = None  # standard uncertainty of the threshold; None where the method states none
    level: float = field(init=False)  # log10 level of the next blink

    def __post_init__(self) -> None:
        first = self.spot.highest_log10 - 1.0 if self.last is None else self.last - self._below()
        self.level = min(max(first, self.spot.lowest_log10), self.spot.highest_log10)

    @abstractmethod
    def answer(self, *, seen: bool) -> None:
        """Take the answer to the blink at `level` and go on."""

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
class QuestPlusSearch(Search):
    """One threshold by QUEST+, on the package `questplus`; the prior is centred on the threshold before, else flat.

    The psychometric function is a Weibull function of log10 luminance; its threshold is where the chance of an answer
    is 1 − 1/e (but for lapses and false alarms). The slope is a nuisance: it is marginalised out.

    Source: Watson 2017, QUEST+: a general multidimensional Bayesian adaptive psychometric method, J. Vision 17(3):10.
    """

    method: QuestPlusMethod
    _levels: NDArray[np.float64] = field(init=False)
    _quest: Any = field(init=False)
    _answers: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        count = round((self.spot.highest_log10 - self.spot.lowest_log10) / self.method.step_log10) + 1
        self._levels = np.linspace(self.spot.lowest_log10, self.spot.highest_log10, count).round(6)
        self._quest = self._begun()
        self.level = float(self._quest.next_stim["intensity"])

    def answer(self, *, seen: bool) -> None:
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


@dataclass
class Ascent(Search):
    """Ascending limits: up by a step per blink until it is seen; an ascent that is seen at once begins lower."""

    method: LimitsMethod
    _missed: bool = False

    def answer(self, *, seen: bool) -> None:
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
        if seen and self._rising:
            self.threshold = self.level
            return
        self._rising = self._rising or not seen
        self._step(self.method.up_log10 if self._rising else -self.method.down_log10)


AnyMethod = LimitsMethod | StaircaseMethod | DownUpMethod | QuestPlusMethod
_SEARCHES: Final[dict[type[AnyMethod], type[Search]]] = {
    LimitsMethod: Ascent,
    StaircaseMethod: Staircase,
    DownUpMethod: DownUp,
    QuestPlusMethod: QuestPlusSearch,
}


def begin(spot: Spot, method: AnyMethod, last: float | None, shift: float = 0.0) -> Search:
    """Return the search for the next threshold, begun near the last one.

    Args:
        spot: The spot's levels.
        last: Threshold before, log10; None at the start.
        shift: Part of a step, 0 to 1, by which limits and staircase begin lower. By chance from threshold to threshold,
            it keeps them from lying on one grid of levels, where errors of neighbours go together.

    Raises:
        MissingLibrary: For QUEST+ without its library.
    """
    return _SEARCHES[type(method)](spot, method, last, shift)


Watcher = Callable[[Event], None]
SUBJECT: Final = "subject"
SWITCHED_OFF: Final = "light off"  # who ended a test whose lights another program switched off
HOPELESS: Final = 15  # trials without one threshold, but with false presses, after which the test is over
# Of a stage's facts, those that may not change within a run; warnings and firmware may.
_SAME_STAGE: Final = (
    "box", "screen", "calibrated", "distance_mm", "pixel_mm", "filter_density", "fixation_w_sr_m2", "eye",
)  # fmt: skip
SAME_TIME_S: Final = 1e-4  # to which the journal gives times
ABOVE_LOG10: Final = 1.0  # how far above the last threshold a spot is that only lapses miss; half of it at least
LOST_OF: Final = (2, 3)  # of so many checks of fixation in a row so many seen: the subject is asked to look at the mark
LOOK_S: Final = 0.5  # how often a rest looks whether a pause is asked for, or a pause whether it is over


class Stage(ABC):
    """The devices in front of the subject, on one clock. What few of them have is answered here for the others."""

    protocol: AdaptationProtocol  # what is done, as far as the devices reach
    ended: Callable[[], bool]  # whether the end of the test is asked for: a bleach that can be ended ends then

    @abstractmethod
    def now_s(self) -> float:
        """Return the time in s since the stage was set up."""

    def wall_s(self) -> float | None:
        """Return the time of day as Unix time in s; None where time is simulated."""
        return None

    @abstractmethod
    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Give the bleach and return when it is over. Raises DeviceError, UnsafeStimulus."""

    @abstractmethod
    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Show one blink (None: none, a catch) and return the presses during it in s from its onset."""

    def shown_log10(self, log10_level: float) -> float:
        """Return the level that is shown where one is asked for: some have whole steps only."""
        return log10_level

    @property
    def checks_fixation(self) -> bool:
        """Return whether it can show a light in the blind spot."""
        return False

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        """Show the light in the blind spot once and return the presses in s from its onset.

        Raises:
            UsageError: If it has none.
            DeviceError: If the devices fail.
        """
        raise UsageError("this stage has no light in the blind spot")

    @abstractmethod
    def rest(self, seconds: float) -> int:
        """Let time pass in the dark and return how often the button was pressed."""

    def long_press(self, at_least_s: float) -> float | None:
        """Return when a press that lasts so long began, on the stage's clock; each once, None where none is."""
        return None

    @abstractmethod
    def resume_at(self, time_s: float) -> None:
        """Count on from a time, after a crash."""

    @property
    def switched_off(self) -> bool:
        """Return whether another program has switched the lights off: the test ends."""
        return False

    def facts(self) -> Mapping[str, Any]:
        """Return what the journal should hold of it; empty for nothing."""
        return {}

    def health(self) -> Mapping[str, str]:
        """Return how it is now, for whoever watches. Raises DeviceError."""
        return {}


def run_test(
    protocol: AdaptationProtocol,
    stage: Stage,
    journal: RunJournal,
    *,
    subject: str,
    seed: int = 0,
    watch: Watcher = lambda event: None,
    controls: Controls | None = None,
    checks: Sequence[Check] = (),
    eye: str | None = None,
    visit: Mapping[str, str | float] | None = None,
    bleaches: bool = True,
) -> Outcome:
    """Run a test from the beginning, or from where its journal ends.

    Args:
        journal: An open journal; events in it are not done again.
        watch: Told every new event.
        controls: Where pauses and the end are asked for; by the subject's long press alone where None.
        checks: Made before the bleach; what they find is journalled, what they refuse is raised.
        eye: "right" or "left", for the journal; None where it is not known.
        visit: What else the journal's head states of subject and visit, by name.
        bleaches: Whether it begins with the bleach; a practice run does not.

    Raises:
        UsageError: If the journal is of another subject or protocol.
        RadiometerError: If a check refuses, such as a MeasurementError where the room is not dark.
        DeviceError: If a device fails; the run can be taken up again.
        MissingLibrary: If the protocol's method is QUEST+ and `questplus` is not installed.
    """
    run = _Run(
        protocol, stage, journal, subject, seed, watch, controls or Controls(), checks, eye, visit or {}, bleaches
    )
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
    journal: RunJournal
    subject: str
    seed: int
    watch: Watcher
    controls: Controls
    checks: Sequence[Check]
    eye: str | None
    visit: Mapping[str, str | float]
    bleaches: bool

    def note(self, kind: str, *, lasting: bool = True, **facts: Any) -> Event:
        event = self.journal.write(kind, self.stage.now_s(), lasting=lasting, **facts)
        self.watch(event)
        return event

    def start(self) -> None:
        """Begin anew, or check that the journal is this test's and set the clock to its end."""
        if not self.journal.events:
            self._begin()
        self._check_journal()
        if not self.journal.of_kind("dark"):
            self._prepare()
            return
        if not self.journal.of_kind("end"):
            self._check_stage()
            self._take_up()

    def _begin(self) -> None:
        wall_s = self.stage.wall_s()
        name = self.protocol.name
        facts: dict[str, Any] = {"format": FORMAT, "subject": self.subject, "protocol": name, "seed": self.seed}
        facts["protocol_hash"] = self.protocol.content_hash()
        if self.eye is not None:
            facts["eye"] = self.eye
        self.note(START, **{**facts, **self.visit}, unix_s=wall_s, facts=facts_of(self.protocol))

    def _check_journal(self) -> None:
        begun = self.journal.events[0]
        if begun.get("protocol_hash", self.protocol.content_hash()) != self.protocol.content_hash():
            raise UsageError(
                f"{self.journal.path}: protocol {self.protocol.name!r} has changed since this run began; restore "
                "it, or name another journal"
            )
        mine_by_key = {"subject": self.subject, "protocol": self.protocol.name, "seed": self.seed}
        later = {"eye": self.eye, "age_years": self.visit.get("age_years"), "pupil_mm": self.visit.get("pupil_mm")}
        for key, mine in {**mine_by_key, **later}.items():
            known = begun.get(key, later.get(key))  # a run that began without may state it now
            if known != mine and mine is not None:
                raise UsageError(f"{self.journal.path}: belongs to {key} {known!r}, not {mine!r}; name another journal")

    def _check_stage(self) -> None:
        """Refuse to go on with another box or screen: thresholds of two calibrations are no curve."""
        now = self.stage.facts()
        for noted in self.journal.of_kind("stage")[:1]:
            for name in _SAME_STAGE:
                if name in noted and name in now and noted[name] != now[name]:
                    raise UsageError(
                        f"{self.journal.path}: begun with {name} {noted[name]!r}, not {now[name]!r}; go on with what "
                        "it was begun with, or name another journal"
                    )

    def _take_up(self) -> None:
        """Set the clock: the eye went on adapting while the program was away, simulated time stood still."""
        last_s, wall_s, begun_s = self._latest_s, self.stage.wall_s(), self.journal.events[0].get("unix_s")
        if wall_s is None or begun_s is None:
            self.stage.resume_at(last_s)
        else:
            self.stage.resume_at(max(last_s, wall_s - begun_s))
            self.note("taken_up", away_s=round(self.stage.now_s() - last_s, 3))
        if self._paused:
            self.note("resume", by="restart")

    def _prepare(self) -> None:
        if facts := self.stage.facts():
            self.note("stage", **facts)
        for check in self.checks:
            finding = check()
            self.note(finding.kind, **finding.facts)
            if finding.refusal is not None:
                self.note(REFUSED, reason=str(finding.refusal))
                raise finding.refusal
        bleach = self.protocol.bleach
        if self.bleaches:
            self.note("bleach", light=bleach.model_dump())
            self.stage.ended = lambda: self.controls.stopped_by is not None
            self.stage.bleach(self.protocol)
        else:  # a practice run: the mark alone is lit
            self.stage.resume_at(self.stage.now_s())
        self.note("dark", steady=isinstance(bleach, SteadyBleach))
        self._ask_again()
        if self.controls.stopped_by is not None:
            self.note("stop", by=self.controls.stopped_by)

    @property
    def _latest_s(self) -> float:
        return float(self.journal.events[-1]["time_s"])

    @property
    def _dark_since_s(self) -> float:
        return float(self.journal.of_kind("dark")[0]["time_s"])

    @property
    def _paused(self) -> bool:
        return len(self.journal.of_kind("pause")) > len(self.journal.of_kind("resume"))

    @property
    def _blinks(self) -> list[Event]:
        """Return the blinks of the trial that is going on, such as those from before a crash."""
        found: list[Event] = []
        for event in reversed(self.journal.events):
            if event["kind"] == "blink":
                found.append(event)
            elif event["kind"] != "taken_up":
                break
        return found[::-1]

    def trial(self) -> None:
        """Find one threshold, or give a catch, and journal it; or pause."""
        number = len(self.journal.of_kind("trial"))
        rng = np.random.default_rng([self.seed, number])
        # The pause stands before the trial, so that a run taken up after a crash keeps the same times.
        if number and not self._blinks and self._rest_between():
            return
        match self._kind_of_trial(rng.random()):
            case "blank":
                self._catch(number, int(rng.integers(2, 5)))
            case "bright":
                self._single(number, BRIGHT)
            case "blind_spot":
                self._single(number, BLIND_SPOT)
                self._announce_lost_fixation()
            case _:
                self._threshold(number, shift=rng.random())

    def _kind_of_trial(self, drawn: float) -> str | None:
        """Return the kind of catch that a number drawn from 0 to 1 selects; None for a threshold."""
        if self._blinks:  # a trial that a crash has cut stays what it was
            return kind_of_catch(self._blinks[0])
        watch, check = self.protocol.watch, self.protocol.fixation_check
        if drawn < watch.catch_share:
            return BLANK
        drawn -= watch.catch_share
        if drawn < watch.lapse_share:
            return None if self._bright_level() is None else BRIGHT
        drawn -= watch.lapse_share
        if check is None or not self.stage.checks_fixation or self._latest_s - self._dark_since_s < 60 * check.from_min:
            return None
        return BLIND_SPOT if drawn < check.share else None

    def _bright_level(self) -> float | None:
        """Return a level that whoever attends sees; None where none is known or the spot does not get so bright."""
        last, highest = self._last(), self.protocol.spot.highest_log10
        return None if last is None or last + 0.5 * ABOVE_LOG10 > highest else min(last + ABOVE_LOG10, highest)

    def _rest_between(self) -> bool:
        """Let the time between two trials pass, and return whether a pause came."""
        left_s = self.protocol.watch.pause_between_s
        while left_s > 0:
            self.stage.rest(min(left_s, LOOK_S))
            left_s -= LOOK_S
            if self._pause_asked():
                return True
        return False

    def _blink(self, level: float | None, number: int, of: str | None = None) -> Event:
        blinks, onset_s = len(self._blinks), self.stage.now_s()
        if of == BLIND_SPOT:
            presses = self.stage.blink_blind_spot(number, blinks)
        else:
            presses = self.stage.blink(level, number, blinks)
        named = {} if of is None else {"of": of}
        return self.note(
            "blink",
            lasting=bool(presses),
            trial=number,
            onset_s=round(onset_s, 4),
            log10_level=None if level is None else round(level, 4),
            presses_s=[round(press, 4) for press in presses],
            **named,
        )

    def _catch(self, number: int, blinks: int) -> None:
        while len(self._blinks) < blinks:
            self._blink(None, number)
            if self._pause_asked():
                return
        pressed = any(blink["presses_s"] for blink in self._blinks)
        self.note("trial", catch=True, false_press=pressed, threshold=None)

    def _single(self, number: int, of: str) -> None:
        """Give a catch of one blink: a bright spot, or the light in the blind spot."""
        if not self._blinks:
            self._blink(self._bright_level() if of == BRIGHT else None, number, of)
            if self._pause_asked():
                return
        fastest_s = self.protocol.watch.fastest_press_s
        seen = any(press >= fastest_s for blink in self._blinks for press in blink["presses_s"])
        minutes = round((self._latest_s - self._dark_since_s) / 60, 5)
        self.note("trial", catch=True, of=of, seen=seen, false_press=False, threshold=None, minutes=minutes)

    def _announce_lost_fixation(self) -> None:
        """Journal that fixation is lost where enough of the latest lights in the blind spot were seen."""
        lost, of = LOST_OF
        announced = max((event["sequence"] for event in self.journal.of_kind("fixation")), default=-1)
        checks = [t for t in self.journal.of_kind("trial") if t.get("of") == BLIND_SPOT and t["sequence"] > announced]
        seen = sum(bool(check["seen"]) for check in checks[-of:])
        if seen >= lost:
            self.note("fixation", lost=seen, of=len(checks[-of:]))

    def _threshold(self, number: int, shift: float) -> None:
        search = begin(self.protocol.spot, self.protocol.method, self._last(), shift)
        for blink in self._blinks:
            search.answer(seen=bool(blink["presses_s"]))
        while not self._over(search):
            blink = self._blink(search.level, number)
            if self._pause_asked():
                return
            search.answer(seen=bool(blink["presses_s"]))
        blinks, hasty = self._blinks, self._hasty()
        middle_s = 0.5 * (blinks[0]["onset_s"] + self._latest_s)
        self.note(
            "trial",
            catch=False,
            false_press=hasty,
            threshold=None if search.threshold is None or hasty else round(self._shown(search.threshold), 4),
            u_log10=None if search.u_log10 is None or hasty else round(search.u_log10, 4),
            minutes=round((middle_s - self._dark_since_s) / 60, 5),
            blinks=len(blinks),
            seen=sum(bool(blink["presses_s"]) for blink in blinks),
        )

    def _shown(self, threshold: float) -> float:
        """Return the level that was seen; other methods' thresholds are between levels as it is."""
        return self.stage.shown_log10(threshold) if isinstance(self.protocol.method, LimitsMethod) else threshold

    def _over(self, search: Search) -> bool:
        """Return whether a search has found its threshold, has no way on, has taken too long, or met a hasty press."""
        ended = search.threshold is not None or search.exhausted
        return ended or self._hasty() or len(self._blinks) >= self.protocol.watch.most_blinks

    def _hasty(self) -> bool:
        fastest_s = self.protocol.watch.fastest_press_s
        return any(press < fastest_s for blink in self._blinks for press in blink["presses_s"])

    def _last(self) -> float | None:
        found = [t["threshold"] for t in counting_trials(self.journal) if t["threshold"] is not None]
        return float(found[-1]) if found else None

    def _pause_asked(self) -> bool:
        """Pause or stop if the subject or the operator asks for it, and return whether the trial is off."""
        self._ask_again()
        held_since_s = self.stage.long_press(self.protocol.watch.hold_to_pause_s)
        by = self.controls.paused_by if held_since_s is None else SUBJECT
        if by is not None and self.controls.stopped_by is None:
            self._pause(by, self._answered_by(held_since_s))
        if self.controls.stopped_by is not None:
            self.note("stop", by=self.controls.stopped_by)
        return by is not None or self.controls.stopped_by is not None

    def _ask_again(self) -> None:
        """Ask for the end where another program switched the lights off, and for what was asked for at this moment.

        The latter is of a run that is lived through again.
        """
        if self.stage.switched_off:
            self.controls.stop(SWITCHED_OFF)
        before = self.journal.upcoming
        if before is None or self.stage.now_s() < float(before["time_s"]) - SAME_TIME_S:
            return
        if before["kind"] == "pause" and before["by"] != SUBJECT:
            self.controls.pause(before["by"])
        elif before["kind"] == "resume":
            self.controls.resume()
        elif before["kind"] == "stop":
            self.controls.stop(before["by"])

    def _pause(self, by: str, voids: int | None) -> None:
        """Wait in the dark until whoever asked for it, or the operator, goes on, or it takes too long."""
        known = self.journal.upcoming is not None
        self.note("pause", by=by, voids=voids)
        begun_s = self._latest_s
        longest_s = 60 * self.protocol.watch.longest_pause_min
        if by == SUBJECT:
            self.controls.pause(by)
        if known and self.journal.upcoming is None:  # a crash met the pause; whoever restarts wants to go on
            self.controls.resume()
        while self.controls.paused_by is not None and self.controls.stopped_by is None:
            if self.stage.rest(LOOK_S) and by == SUBJECT:
                self.controls.resume()
            self.controls.linger()
            self._ask_again()
            if self.stage.now_s() - begun_s >= longest_s:
                return
        if self.controls.stopped_by is None:
            self.note("resume", by=by, paused_s=round(self.stage.now_s() - begun_s, 3))

    def _answered_by(self, held_since_s: float | None) -> int | None:
        """Return the sequence number of the trial that a long press has ended; it was no answer."""
        trials = self.journal.of_kind("trial")
        ended = held_since_s is not None and bool(trials) and held_since_s <= float(trials[-1]["time_s"])
        return int(trials[-1]["sequence"]) if ended else None

    def finished(self) -> Outcome | None:
        """Return the outcome if the test is over."""
        verdict = self._verdict()
        return None if verdict is None else outcome_of(self.journal, verdict, self.protocol)

    def _verdict(self) -> Verdict | None:
        if self.journal.of_kind("stop"):
            return Verdict.STOPPED
        trials = counting_trials(self.journal)
        tries = [t for t in trials if not t["catch"]]
        found = [t["threshold"] for t in tries if t["threshold"] is not None]
        if self._paused:
            return Verdict.LEFT if found else Verdict.NO_RESPONSE
        if not found and len(trials) >= HOPELESS and too_many_false(trials, self.protocol):
            return Verdict.UNRELIABLE
        recent = tries[-self.protocol.watch.absent_after :]
        if len(recent) == self.protocol.watch.absent_after and all(map(self._fruitless, recent)):
            return _why_fruitless(recent, known=bool(found))
        criterion = self.protocol.end.criterion_log10
        last = found[-self.protocol.end.beyond :]
        if criterion is not None and len(last) == self.protocol.end.beyond and max(last) <= criterion:
            return Verdict.CRITERION_REACHED
        if self._latest_s - self._dark_since_s >= 60 * self.protocol.end.duration_min:
            return Verdict.COMPLETE if self.bleaches else Verdict.PRACTICE
        return None

    def _fruitless(self, trial: Event) -> bool:
        """Return whether a trial gave no threshold though a subject who is there would have given one."""
        blind = trial["seen"] == 0 and trial["minutes"] < self.protocol.watch.blind_min
        return trial["threshold"] is None and not trial["false_press"] and not blind


def _why_fruitless(trials: list[Event], *, known: bool) -> Verdict:
    """Return why trials in a row gave no threshold; `known` states whether earlier ones did."""
    later = trials[1:] if known and len(trials) > 1 else trials  # presses may have stopped within the first of them
    if not any(trial["seen"] for trial in later):
        return Verdict.LEFT if known else Verdict.NO_RESPONSE
    if known and all(trial["seen"] == trial["blinks"] for trial in trials):
        return Verdict.FLOOR_REACHED
    return Verdict.UNRELIABLE
