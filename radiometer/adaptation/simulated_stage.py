"""A simulated subject as a stage of the adaptation test, without any device, in simulated time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from radiometer.adaptation.protocol import AdaptationProtocol, FlashBleach, SteadyBleach
from radiometer.adaptation.run import Stage
from simulators.clock import SimulatedClock
from simulators.observers.eye_kinetics import Eye, eye_after_bleach, scotopic_per_photopic
from simulators.observers.observer import Observer, behaviour_of

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
