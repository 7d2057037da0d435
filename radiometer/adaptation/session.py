"""Composition of a run: the stage that a request asks for, its checks, its journal, and who watches it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.adaptation.box_setup import open_box_stage
from radiometer.adaptation.checks import Check
from radiometer.adaptation.live import LivePage, LiveText, event_line, replayed
from radiometer.adaptation.outcome import Outcome, RunJournal, devices_of
from radiometer.adaptation.protocol import AdaptationProtocol, FlashBleach, SteadyBleach
from radiometer.adaptation.request import SIMULATED_BOX, Controls, RunRequest
from radiometer.adaptation.run import Stage, run_test
from radiometer.adaptation.run_facts import facts_of
from radiometer.adaptation.screen_setup import ScreenStage, open_screen_stage
from radiometer.bench.box_holder import darken_held
from radiometer.data.event_journal import Event
from radiometer.data.json_text import json_text
from radiometer.errors import UsageError
from simulators.clock import SimulatedClock
from simulators.observers.eye_kinetics import Eye, eye_after_bleach, scotopic_per_photopic
from simulators.observers.observer import BEHAVIOURS, Observer, behaviour_of

_WHITE_SCOTOPIC_RATIO: Final = 2.0  # of a white LED's light, as the subject before the simulated box has it
_ANSWERS: Final = 1  # keeps the answers' chance apart from that of the run, whose seed is [seed, trial]


@dataclass
class SubjectStage(Stage):
    """A simulated subject before a simulated spot; no time passes but on the clock."""

    protocol: AdaptationProtocol
    observer: Observer  # who answers
    leaves_after_min: float = math.inf  # time in the dark in min after which nothing is pressed
    seed: int = 0  # makes the answers; each follows from seed, trial and blink alone
    clock: SimulatedClock = field(default_factory=SimulatedClock)  # simulated time

    def now_s(self) -> float:
        return self.clock.now_s()

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Let the bleach's time pass, and bleach the subject's eye as much as its light does."""
        self.clock.advance(protocol.bleach.duration_s)
        self.observer.eye = _bleached(self.observer.eye, protocol.bleach)
        self.observer.dark_since_s = self.clock.now_s()

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        return self._presses(log10_level, self.protocol.spot.peak_nm, trial, number)

    @property
    def checks_fixation(self) -> bool:
        return self.protocol.fixation_check is not None

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        check, peak_nm = self.protocol.fixation_check, self.protocol.fixation.peak_nm
        if check is None:
            return []
        level = math.log10(check.luminance_cd_m2 * scotopic_per_photopic(peak_nm))
        return self._presses(level, peak_nm, trial, number, (check.temporal_deg, -check.below_deg))

    def _presses(
        self, level: float | None, peak_nm: float, trial: int, number: int, place_deg: tuple[float, float] | None = None
    ) -> list[float]:
        onset_s = self.clock.now_s()
        self.clock.advance(self.protocol.spot.cycle_s)
        if onset_s - self.observer.dark_since_s > 60.0 * self.leaves_after_min:
            return []
        # A run that was taken up after a crash goes on as it would have.
        self.observer.rng = np.random.default_rng([_ANSWERS, self.seed, trial, number])
        reaction_s = self.observer.answer(level, onset_s, peak_nm, place_deg)
        return [] if reaction_s is None else [reaction_s]

    def rest(self, seconds: float) -> int:
        """Let time of a pause pass; there are no presses."""
        self.clock.advance(seconds)
        return 0

    def resume_at(self, time_s: float) -> None:
        """Bleach the subject as it was, and move the clock to a time after a crash."""
        self.bleach(self.protocol)
        self.clock.advance(max(0.0, time_s - self.clock.now_s()))


def _bleached(eye: Eye, bleach: SteadyBleach | FlashBleach) -> Eye:
    """Return an eye as a bleach leaves it, through the protocol's pupil where that is stated."""
    seen_by = eye if bleach.pupil_mm is None else replace(eye, pupil_mm=bleach.pupil_mm)
    if isinstance(bleach, SteadyBleach):
        luminance_cd_m2 = bleach.luminance_cd_m2
    else:
        area_mm2 = math.pi / 4.0 * seen_by.pupil_mm**2
        luminance_cd_m2 = bleach.retinal_td_s / (bleach.duration_s * area_mm2 * _WHITE_SCOTOPIC_RATIO)
    return eye_after_bleach(seen_by, luminance_cd_m2, bleach.duration_s, _WHITE_SCOTOPIC_RATIO)


def simulated_stage(protocol: AdaptationProtocol, behaviour: str, *, seed: int = 0) -> SubjectStage:
    """Return a stage with a simulated subject, whose eye and habits are those before the simulated box.

    Args:
        behaviour: Name of a behaviour of `simulators.observers.observer`.
        seed: Makes the answers, and the eye where it is a drawn one.

    Raises:
        UsageError: If the behaviour is unknown.
    """
    chosen = behaviour_of(behaviour)
    observer = Observer(chosen.eye(np.random.default_rng(seed)), chosen.habits)
    return SubjectStage(protocol, observer, chosen.leaves_after_min, seed)


Watcher = Callable[[Event], None]


def prompts_after(event: Event) -> tuple[str, ...]:
    """Return the prompts that an event calls for, in order.

    "bleach" (it begins), "dark" (it is over), "mark" (look at the red mark), "threshold" (found), "pause", "resume",
    "end".
    """
    match event["kind"]:
        case "dark":
            return ("dark", "mark")
        case "fixation":
            return ("mark",)
        case "bleach" | "pause" | "resume" | "end" as kind:
            return (str(kind),)
        case "trial" if not event["catch"] and event["threshold"] is not None:
            return ("threshold",)
        case _:
            return ()


def with_prompts(journal: RunJournal, watch: Watcher, sound: Watcher) -> Watcher:
    """Return a watcher that journals prompts and has them sounded as well; those that a crash left out at once.

    Args:
        journal: The open journal of the test.
        watch: Called with every event.
        sound: Called with every prompt, as an event of kind "prompt".

    Raises:
        OutputError: If the disk refuses a prompt; so does the watcher.
    """

    def give(event: Event, given: int = 0) -> None:
        for say in prompts_after(event)[given:]:
            sound(journal.write("prompt", float(event["time_s"]), say=say))

    def watch_and_prompt(event: Event) -> None:
        watch(event)
        give(event)

    for given, event in enumerate(reversed(journal.events)):
        if event["kind"] != "prompt":
            give(event, given)
            break
    return watch_and_prompt


@dataclass(frozen=True, slots=True)
class Session:
    """A run whose devices and journal are open."""

    request: RunRequest  # what was asked for
    stage: Stage  # the devices before the subject
    checks: Sequence[Check]  # what is checked before the bleach
    journal: RunJournal  # every event, before the next one happens
    controls: Controls = field(default_factory=Controls)  # where pauses and the end are asked for

    def run(self, watch: Watcher = lambda event: None) -> Outcome:
        """Run the test from the beginning, or from where its journal ends. Raises as `run_test`.

        Args:
            watch: Called with every new event.
        """
        asked = self.request
        return run_test(
            self.stage.protocol, self.stage, self.journal, subject=asked.subject, seed=asked.seed, watch=watch,
            controls=self.controls, checks=self.checks, eye=asked.eye, visit=asked.header(),
            bleaches=not asked.practice,
        )  # fmt: skip

    @staticmethod
    def event_line(event: Event) -> str | None:
        """Return one line for an event; None for one that a reader need not see."""
        return event_line(event)

    @staticmethod
    def event_json(event: Event) -> str:
        """Return an event as one line of JSON, as the journal holds it."""
        return json_text(event)

    def live_text(self) -> LiveText:
        """Return the running test as lines of text, with what the journal holds already."""
        return LiveText(self.stage.protocol, self.journal.events)

    @contextmanager
    def page(self, port: int, *, audio: bool, announce: Callable[[str], None]) -> Iterator[Watcher]:
        """Serve the running test as a page for the block; yield what takes its events.

        Args:
            port: Port of the page; 0 for any free one.
            announce: Called with its address.

        Raises:
            DeviceInUse: If the port is taken.
        """
        with LivePage(
            self.stage.protocol, self.controls, port, audio=audio, health=self.stage.health, darken=darken_held
        ) as page:
            announce(page.url)
            replayed(page, self.journal.events)
            yield page.publish

    def table(self, outcome: Outcome) -> str:
        """Return the thresholds as CSV, with the facts that belong to their fit."""
        shared = [event["u_scale_log10"] for event in self.journal.of_kind("stage") if event.get("u_scale_log10")]
        asked = self.request
        visit = asked.header() | devices_of(self.journal.events)
        facts = facts_of(asked.protocol, shared[-1] if shared else None, outcome.reliability, visit)
        return outcome.to_csv(facts)

    def reach_sentence(self) -> str | None:
        """Return how the devices narrow the protocol's spot; None where they give all of it."""
        asked, shown = self.request.protocol.spot, self.stage.protocol.spot
        if (asked.lowest_log10, asked.highest_log10) == (shown.lowest_log10, shown.highest_log10):
            return None
        return (
            f"the {asked.channel} spot goes from {shown.lowest_log10:.2f} to {shown.highest_log10:.2f} log₁₀ "
            f"scotopic cd·m⁻² on this screen; {self.request.protocol.name} asks for {asked.lowest_log10:g} to "
            f"{asked.highest_log10:g}"
        )


@contextmanager
def open_session(
    request: RunRequest,
    journal: Path,
    controls: Controls | None = None,
    *,
    announce: Callable[[str], None] = lambda url: None,
    notice: Callable[[str], None] = lambda line: None,
) -> Iterator[Session]:
    """Open devices and journal of a run for the block.

    Args:
        journal: File of the journal; one that exists is taken up.
        controls: Where pauses and the end are asked for.
        announce: Called with the address of the subject's page.
        notice: Gets what must be known before the run, a line each.

    Raises:
        UsageError: If protocol, box, screen and subject exclude each other.
        RadiometerError: If a device or calibration cannot be used.
    """
    with ExitStack() as held:
        stage, checks = held.enter_context(_stage(request, announce))
        for warning in stage.screen.warnings() if isinstance(stage, ScreenStage) else ():
            notice(f"warning: {warning}")
        begun = journal.is_file() and journal.stat().st_size > 0
        written = held.enter_context(RunJournal(journal, relive=request.box == SIMULATED_BOX))
        session = Session(request, stage, checks, written, controls or Controls())
        narrowed = session.reach_sentence()
        if narrowed is not None:
            notice(narrowed)
        if begun:
            notice(f"{journal} holds a run: taking it up")
        yield session


def _stage(
    request: RunRequest, announce: Callable[[str], None]
) -> AbstractContextManager[tuple[Stage, Sequence[Check]]]:
    protocol = request.protocol
    on_screen = protocol.spot.device == "screen"
    if request.screen is not None and not on_screen:
        raise UsageError(f"protocol {protocol.name} shows its spot by the light box; --screen is for screen-only")
    if on_screen and request.box is None and (request.screen is not None or request.simulate is None):
        return open_screen_stage(request, announce)
    if request.simulate is not None and request.box is None:
        return nullcontext((simulated_stage(protocol, request.simulate, seed=request.seed), ()))
    if request.simulate is None and request.box == SIMULATED_BOX:
        raise UsageError(f"the simulated box needs a simulated subject: --simulate {', '.join(BEHAVIOURS)}")
    return open_box_stage(request)
