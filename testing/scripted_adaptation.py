"""A stage whose subject follows a rule, in simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.run import Stage
from radiometer.errors import DeviceLost

Eye = Callable[[float | None, float], bool]


@dataclass(frozen=True, slots=True)
class SubjectCurve:
    """Threshold after a bleach, log10 scotopic cd·m⁻² over minutes in the dark: cones, then rods along S2 and S3.

    Attributes:
        cone_plateau: Final threshold of the cones.
        cone_rise: How far above it the cones begin.
        cone_tau_min: Time constant of the cones in min.
        break_min: Time of the rod–cone break in min.
        s2_per_min: Slope of the rods' second component in log10 units per min, below 0.
        s3_from: Level below the cone plateau at which the third component takes over, log10 units.
        s3_per_min: Its slope.
        final: Final threshold.
    """

    cone_plateau: float = -1.0
    cone_rise: float = 2.0
    cone_tau_min: float = 1.6
    break_min: float = 9.0
    s2_per_min: float = -0.24
    s3_from: float = 2.0
    s3_per_min: float = -0.05
    final: float = -4.2

    def threshold(self, minutes: float) -> float:
        """Return the threshold at a time in the dark: the lower of the two branches."""
        cones = self.cone_plateau + self.cone_rise * math.exp(-minutes / self.cone_tau_min)
        fallen = -self.s2_per_min * (minutes - self.break_min)
        if fallen > self.s3_from:
            fallen = self.s3_from + -self.s3_per_min * (fallen - self.s3_from) / -self.s2_per_min
        return max(min(cones, self.cone_plateau - fallen), self.final)


class ScriptedStage(Stage):
    """A stage in simulated time whose subject follows a rule: (log10 level or None, seconds in the dark) -> presses."""

    switched_off = False
    checks_fixation = False

    def __init__(self, eye: Eye, protocol: AdaptationProtocol, *, latency_s: float = 0.4) -> None:
        self.eye, self.protocol, self.latency_s = eye, protocol, latency_s
        self.time, self.dark_since, self.dies_after = 0.0, 0.0, math.inf
        self.at: dict[float, Callable[[], None]] = {}
        self.held_since: float | None = None
        self.ended = lambda: False
        self.presses_in_pause: list[float] = []
        self.unix: float | None = None

    def pass_time(self, seconds: float) -> None:
        """Let time pass, and what was planned for it happen."""
        self.time += seconds
        for when in [when for when in self.at if when <= self.time]:
            self.at.pop(when)()

    def now_s(self) -> float:
        return self.time

    def bleach(self, protocol: AdaptationProtocol) -> None:
        self.time += protocol.bleach.duration_s
        self.dark_since = self.time

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        if self.time > self.dies_after:
            raise DeviceLost("the box went away")
        seen = self.eye(log10_level, self.time - self.dark_since)
        self.pass_time(self.protocol.spot.cycle_s)
        return [self.latency_s] if seen else []

    def wall_s(self) -> float | None:
        return None if self.unix is None else self.unix + self.time

    def rest(self, seconds: float) -> int:
        self.pass_time(seconds)
        pressed = [when for when in self.presses_in_pause if when <= self.time]
        self.presses_in_pause = [when for when in self.presses_in_pause if when > self.time]
        return len(pressed)

    def long_press(self, at_least_s: float) -> float | None:
        since = self.held_since
        self.held_since = None
        return since

    def resume_at(self, time_s: float) -> None:
        self.time = time_s
        self.dark_since = self.protocol.bleach.duration_s


def threshold(seconds: float) -> float:
    """Return a textbook curve: cones to -1, rods from about 9 min on, -0.24 log per min."""
    minutes = seconds / 60
    cones = -1 + 1.5 * math.exp(-minutes / 1.5)
    return max(min(cones, -1 - 0.24 * (minutes - 9)), -4.2) if minutes > 9 else cones


def eye(level: float | None, seconds: float) -> bool:
    """See whatever is above the curve."""
    return level is not None and level >= threshold(seconds)
