"""A simulated subject as a stage of the adaptation test, without any device, in simulated time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.errors import UsageError
from simulators.clock import SimulatedClock
from simulators.observers.subject import SimulatedSubject, SubjectCurve

BEHAVIOURS = ("steady", "never", "always", "leaves", "wanders")


@dataclass
class SubjectStage:
    """A simulated subject before a simulated spot; no time passes but on the clock."""

    protocol: AdaptationProtocol  # the protocol
    subject: SimulatedSubject  # who answers
    clock: SimulatedClock = field(default_factory=SimulatedClock)  # simulated time

    def now_s(self) -> float:
        """Return the simulated time in s."""
        return self.clock.now_s()

    def wall_s(self) -> float | None:
        """Return None: time is simulated."""
        return None

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Let the bleach's time pass."""
        self.clock.advance(protocol.bleach.duration_s)

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Return the subject's presses."""
        minutes = (self.clock.now_s() - self.protocol.bleach.duration_s) / 60.0
        self.clock.advance(self.protocol.spot.cycle_s)
        return self.subject.presses(log10_level, minutes, trial, number)

    @property
    def checks_fixation(self) -> bool:
        """Return whether the protocol has a light in the blind spot."""
        return self.protocol.fixation_check is not None

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        """Return the subject's presses to the light in its blind spot."""
        minutes = (self.clock.now_s() - self.protocol.bleach.duration_s) / 60.0
        self.clock.advance(self.protocol.spot.cycle_s)
        return self.subject.presses_at_blind_spot(minutes, trial, number)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.advance(seconds)

    def rest(self, seconds: float) -> int:
        """Let time of a pause pass; there are no presses."""
        self.clock.advance(seconds)
        return 0

    def long_press(self, at_least_s: float) -> float | None:
        """Return None: this subject presses and lets go."""
        return None

    def resume_at(self, time_s: float) -> None:
        """Move the clock to a time after a crash."""
        self.clock.advance(max(0.0, time_s - self.clock.now_s()))


def simulated_stage(protocol: AdaptationProtocol, behaviour: str, *, seed: int = 0) -> SubjectStage:
    """Return a stage with a simulated subject of healthy curve.

    Args:
        behaviour: "steady", "never" (presses), "always" (presses), "leaves" (after 10 min) or "wanders" (looks
            away in two blinks of five).

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
        "wanders": replace(steady, fixation_losses=0.4),
    }
    return SubjectStage(protocol, subjects[behaviour])
