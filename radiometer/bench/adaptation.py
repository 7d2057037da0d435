"""Stages for the adaptation test: a real or simulated box, or a simulated subject in simulated time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from radiometer.adaptation.box_stage import BoxStage
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.stage import Stage
from radiometer.analysis.photometry import luminous_efficacy_lm_per_w
from radiometer.analysis.spectra import spectrum
from radiometer.bench.boxes import open_light_box
from radiometer.errors import UsageError
from simulators.clock import SimulatedClock
from simulators.subject import SimulatedSubject, SubjectCurve

BEHAVIOURS = ("steady", "never", "always", "leaves")


@dataclass
class SubjectStage:
    """A simulated subject before a simulated spot; no time passes but on the clock.

    Attributes:
        protocol: The protocol.
        subject: Who answers.
        clock: Simulated time.
        slow_down_s: Real seconds that each trial's first blink takes, so that a run can be watched or interrupted.
    """

    protocol: AdaptationProtocol
    subject: SimulatedSubject
    clock: SimulatedClock = field(default_factory=SimulatedClock)
    slow_down_s: float = 0.0

    def now_s(self) -> float:
        """Return the simulated time in s."""
        return self.clock.now_s()

    def wall_s(self) -> float | None:
        """Return None: time is simulated."""
        return None

    def room_luminance_cd_m2(self) -> float | None:
        """Return a dark room."""
        return 0.0

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Let the bleach's time pass."""
        self.clock.advance(protocol.bleach.duration_s)

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Return the subject's presses."""
        if self.slow_down_s and number == 0:
            time.sleep(self.slow_down_s)
        minutes = (self.clock.now_s() - self.protocol.bleach.duration_s) / 60.0
        self.clock.advance(self.protocol.spot.cycle_s)
        return self.subject.presses(log10_level, minutes, trial, number)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.advance(seconds)

    def rest(self, seconds: float) -> int:
        """Let time of a pause pass, some of it real where the run is slowed down; nobody presses."""
        self.clock.advance(seconds)
        time.sleep(min(self.slow_down_s, seconds))
        return 0

    def long_press(self, at_least_s: float) -> float | None:
        """Return None: this subject presses and lets go."""
        return None

    def resume_at(self, time_s: float) -> None:
        """Move the clock to a time after a crash."""
        self.clock.advance(max(0.0, time_s - self.clock.now_s()))


def simulated_stage(
    protocol: AdaptationProtocol, behaviour: str, *, seed: int = 0, slow_down_s: float = 0.0
) -> SubjectStage:
    """Return a stage with a simulated subject of healthy curve.

    Args:
        protocol: The protocol.
        behaviour: "steady", "never" (presses), "always" (presses) or "leaves" (after 10 min).
        seed: Makes the answers.
        slow_down_s: Real seconds that a trial takes at least.

    Raises:
        UsageError: If the behaviour is unknown.
    """
    if behaviour not in BEHAVIOURS:
        raise UsageError(f"simulated subject {behaviour!r}: choose {', '.join(BEHAVIOURS)}")
    steady = SimulatedSubject(SubjectCurve(), seed=seed)
    subjects = {
        "steady": steady,
        "never": replace(steady, leaves_after_min=-1.0),
        "always": replace(steady, false_alarm=1.0, lapse=0.0),
        "leaves": replace(steady, leaves_after_min=10.0),
    }
    return SubjectStage(protocol, subjects[behaviour], slow_down_s=slow_down_s)


@contextmanager
def open_box_stage(
    protocol: AdaptationProtocol, name: str | None, calibration: Path | None, *, white: str, fixation_w_sr_m2: float
) -> Iterator[Stage]:
    """Open a light box as a stage for the block; it is dark and released afterwards.

    Raises:
        UsageError: If the protocol wants a screen.
        DeviceError: If the box cannot be opened.
        InputError: If the spectrum is unknown.
    """
    if protocol.spot.device != "light_box":
        raise UsageError(f"protocol {protocol.name} shows its spot on a screen; choose one for the light box")
    photopic = luminous_efficacy_lm_per_w(spectrum(white), "photopic")
    scotopic = luminous_efficacy_lm_per_w(spectrum(f"line:{protocol.spot.peak_nm:g}"), "scotopic")
    with open_light_box(name, calibration=calibration) as opened:
        clock = opened.box.link.line.now  # the clock that the button's times are given on
        wall = time.time if opened.twin is None else None
        yield BoxStage(opened.box, photopic, scotopic, protocol, clock, opened.wait, fixation_w_sr_m2, wall_clock=wall)
