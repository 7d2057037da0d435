"""A simulated subject: sees what its eye can, presses after its reaction time, and errs as people do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from simulators.displays.base import SimulatedDisplay
from simulators.observers.eye_kinetics import Eye, eye_after_bleach, in_blind_spot, scotopic_lm_per_w

# Wavelengths in nm that stand for a simulated display's primaries, and lm per W of its white (displays/lcd.py).
PRIMARY_NM: Final = (610.0, 545.0, 450.0)
WHITE_LM_PER_W: Final = 340.0  # luminous efficacy of radiation of a white LED


@dataclass(frozen=True, slots=True)
class Habits:
    """How a subject answers."""

    # Exponent β of the Weibull psychometric function 1 − exp(−(L/α)^β), L the luminance; 3.5 is usual for detection
    # (Watson and Pelli 1983)
    slope: float = 3.5
    lapses: float = 0.01  # probability of not answering what was seen
    false_alarms: float = 0.01  # probability of answering what was not seen
    reaction_s: float = 0.35  # median reaction time in s
    reaction_spread: float = 0.2  # standard deviation of its natural logarithm
    fixation_losses: float = 0.03  # probability of looking elsewhere when a light comes on


@dataclass(slots=True)
class Observer:
    """A subject in the dark since `dark_since_s`."""

    eye: Eye  # its eye, as the bleach left it
    habits: Habits = field(default_factory=Habits)  # how it answers
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))  # source of chance
    dark_since_s: float = 0.0  # when the bleach ended, in s

    def seen_probability(self, log10_level: float, time_s: float, wavelength_nm: float) -> float:
        """Return the probability of an answer to a blink of log10 scotopic cd·m⁻² at a time in s."""
        threshold = self.eye.threshold_log10((time_s - self.dark_since_s) / 60.0, wavelength_nm)
        # α is where the function reaches 1 − 1/e; a ratio that would overflow is seen for certain.
        ratio = 10.0 ** min(self.habits.slope * (log10_level - threshold), 6.0)
        seen = 1.0 - math.exp(-ratio)
        return self.habits.false_alarms + (1.0 - self.habits.false_alarms - self.habits.lapses) * seen

    def falls_on_blind_spot(self, place_deg: tuple[float, float]) -> bool:
        """Tell whether a light falls on the blind spot of this eye, which may look elsewhere at this moment.

        A glance goes 6° to 12° in any direction; that another place has another threshold is left out.

        Args:
            place_deg: Where it is, in degrees temporal of and above the mark.
        """
        temporal_deg, above_deg = place_deg
        if self.rng.random() < self.habits.fixation_losses:
            angle, away_deg = self.rng.uniform(0.0, 2 * math.pi), self.rng.uniform(6.0, 12.0)
            temporal_deg -= away_deg * math.cos(angle)
            above_deg -= away_deg * math.sin(angle)
        return in_blind_spot(temporal_deg, above_deg)

    def answer(
        self,
        log10_level: float | None,
        time_s: float,
        wavelength_nm: float,
        place_deg: tuple[float, float] | None = None,
    ) -> float | None:
        """Return the reaction time in s to a blink (None: a catch without light), or None for no press.

        Args:
            place_deg: Where it is, in degrees temporal of and above the mark; None for the test spot's place.
        """
        if place_deg is not None and self.falls_on_blind_spot(place_deg):
            log10_level = None
        if log10_level is None:
            probability = self.habits.false_alarms
        else:
            probability = self.seen_probability(log10_level, time_s, wavelength_nm)
        if self.rng.random() >= probability:
            return None
        return float(self.habits.reaction_s * math.exp(self.rng.normal(0.0, self.habits.reaction_spread)))


@dataclass(slots=True)
class ObserverAtScreen:
    """A subject in front of a simulated display, with its hand on a key."""

    observer: Observer  # the subject
    display: SimulatedDisplay  # an open display
    leaves_after_s: float = math.inf  # time after the bleach from which it does not press any more
    filter_density: float = 0.0  # optical density of a filter that it puts before its eye after the bleach

    def stare(self, rgb: tuple[float, float, float], duration_s: float) -> None:
        """Look at a field of a drive 0..1 for a time that ends now: what it bleaches has to recover."""
        luminance = WHITE_LM_PER_W * self.display.radiance(rgb)
        self.observer.eye = eye_after_bleach(self.observer.eye, luminance, duration_s)
        self.observer.dark_since_s = self.display.clock.now_s()

    def answer(self, rgb: tuple[float, float, float], place_deg: tuple[float, float] | None = None) -> float | None:
        """Return the reaction time in s to a spot of a drive 0..1 on black, or None for no press.

        Args:
            place_deg: Where it is, in degrees temporal of and above the mark; None for the test spot's place.

        What the spot adds to the black is what is seen; that a shining black itself raises the threshold is left out.
        """
        time_s = self.display.clock.now_s()
        if time_s - self.observer.dark_since_s > self.leaves_after_s:
            return None
        level, primary = self.level_log10(rgb), max(range(3), key=lambda n: rgb[n])
        return self.observer.answer(level, time_s, PRIMARY_NM[primary], place_deg)

    def level_log10(self, rgb: tuple[float, float, float]) -> float | None:
        """Return what a drive adds to the black, log10 of scotopic cd·m⁻²; None for nothing."""
        black = self.display.radiance((0.0, 0.0, 0.0))
        alone = [tuple(drive if n == k else 0.0 for k in range(3)) for n, drive in enumerate(rgb)]
        added = sum(
            scotopic_lm_per_w(nm) * (self.display.radiance((one[0], one[1], one[2])) - black)
            for nm, one in zip(PRIMARY_NM, alone, strict=True)
        )
        return math.log10(added) - self.filter_density if added > 0 else None
