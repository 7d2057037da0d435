"""A subject who presses a button: branches of threshold over time, a psychometric function, lapses, reaction time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class SubjectCurve:
    """Threshold after a bleach, log10 scotopic cd·m⁻² over minutes in the dark: cones, then rods along S2 and S3."""

    cone_plateau: float = -1.0  # final threshold of the cones
    cone_rise: float = 2.0  # how far above it the cones begin
    cone_tau_min: float = 1.6  # time constant of the cones in min
    break_min: float = 9.0  # time of the rod–cone break in min
    s2_per_min: float = -0.24  # slope of the rods' second component in log10 units per min, below 0
    s3_from: float = 2.0  # level below the cone plateau at which the third component takes over, log10 units
    s3_per_min: float = -0.05  # its slope
    final: float = -4.2  # final threshold

    def threshold(self, minutes: float) -> float:
        """Return the threshold at a time in the dark: the lower of the two branches."""
        cones = self.cone_plateau + self.cone_rise * math.exp(-minutes / self.cone_tau_min)
        fallen = -self.s2_per_min * (minutes - self.break_min)
        if fallen > self.s3_from:
            fallen = self.s3_from + -self.s3_per_min * (fallen - self.s3_from) / -self.s2_per_min
        return max(min(cones, self.cone_plateau - fallen), self.final)


@dataclass(frozen=True, slots=True)
class SimulatedSubject:
    """Presses when the spot is seen."""

    curve: SubjectCurve = SubjectCurve()  # threshold over time: the level seen in half of the blinks
    spread_log10: float = 0.08  # standard deviation of the psychometric function, log10 units
    lapse: float = 0.02  # share of blinks missed whatever their level
    false_alarm: float = 0.01  # chance of a press in a blink without a spot
    reaction_s: float = 0.35  # median reaction time in s; single ones scatter by a fifth
    seed: int = 0  # makes the answers; they follow from seed, trial and blink alone
    leaves_after_min: float = math.inf  # time after which the button is not pressed any more
    fixation_losses: float = 0.03  # chance of looking elsewhere than at the mark when a light comes on

    def presses(self, log10_level: float | None, minutes: float, trial: int, blink: int) -> list[float]:
        """Return the presses during a blink in s from its onset.

        Args:
            log10_level: Level of the spot; None for no spot.
            minutes: Time in the dark in min.
        """
        rng = np.random.default_rng([self.seed, trial, blink])
        chance = self.false_alarm
        if log10_level is not None:
            above = (log10_level - self.curve.threshold(minutes)) / (self.spread_log10 * math.sqrt(2.0))
            seen = 0.5 * (1.0 + math.erf(above))
            chance += (1.0 - self.false_alarm - self.lapse) * seen
        if minutes > self.leaves_after_min or rng.random() >= chance:
            return []
        return [float(self.reaction_s * math.exp(0.2 * rng.standard_normal()))]

    def presses_at_blind_spot(self, minutes: float, trial: int, blink: int) -> list[float]:
        """Return the presses to a bright light in the blind spot: it is seen by an eye that looks elsewhere.

        Args:
            minutes: Time in the dark in min.
        """
        elsewhere = np.random.default_rng([self.seed, trial, blink, 1]).random() < self.fixation_losses
        return self.presses(math.inf if elsewhere else None, minutes, trial, blink)
