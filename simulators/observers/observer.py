"""A simulated subject: sees what its eye can, presses after its reaction time, and errs as people do."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from radiometer.errors import UsageError
from simulators.displays.base import SimulatedDisplay
from simulators.light_box.box import SimulatedLightBox
from simulators.light_box.channel import LedState
from simulators.observers.eye_kinetics import (
    Eye,
    drawn_amd_eye,
    drawn_clinical_eye,
    eye_after_bleach,
    eye_of_pigments,
    in_blind_spot,
    pigments_after_flash,
    scotopic_lm_per_w,
)

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


LEAVES_AFTER_MIN: Final = 10.0  # within every protocol, after the first thresholds


@dataclass(frozen=True, slots=True)
class Behaviour:
    """How a simulated subject behaves."""

    habits: Habits = field(default_factory=Habits)  # how it answers
    leaves_after_min: float = math.inf  # time in the dark in min after which it does not press any more
    taps: bool = False  # whether it presses all the time, whatever is shown
    draws_eye: Callable[[np.random.Generator], Eye] | None = None  # draws its eye; None for the textbook's

    def eye(self, rng: np.random.Generator) -> Eye:
        """Return the eye of one such subject."""
        return Eye() if self.draws_eye is None else self.draws_eye(rng)


BEHAVIOURS: Final = {
    "steady": Behaviour(),
    "never": Behaviour(Habits(lapses=1.0, false_alarms=0.0)),
    "always": Behaviour(Habits(lapses=0.0, false_alarms=1.0), taps=True),
    "leaves": Behaviour(leaves_after_min=LEAVES_AFTER_MIN),
    "wanders": Behaviour(Habits(fixation_losses=0.4)),
    "healthy": Behaviour(draws_eye=drawn_clinical_eye),
    "amd": Behaviour(draws_eye=drawn_amd_eye),
}


def behaviour_of(name: str) -> Behaviour:
    """Return a behaviour by its name. Raises UsageError if there is none of that name."""
    if name not in BEHAVIOURS:
        raise UsageError(f"simulated subject {name!r} is unknown: choose {', '.join(BEHAVIOURS)}")
    return BEHAVIOURS[name]


HOLD_S: Final = 0.15  # how long the button is held
BLEACHES: Final = ("bleach", "field")
BOX_WHITE_LM_PER_W: Final = 320.0  # of a white LED's light: 450 nm pump, phosphor at 560 nm
TAPPING_S: Final = 0.7  # how often a subject presses who always does
LONGEST_S: Final = 3 * 3600.0  # longer than any protocol


@dataclass(slots=True)
class ObserverAtBox:
    """A subject in front of the simulated light box, with its hand on the button.

    What the box's bleaching lights do to the eye follows from their luminance and time; before any bleach the eye is as
    `observer` has it. False alarms come at random times, once in 1/`false_alarms` s on average, for the subject does
    not know when a blink without light (a catch) is due.
    """

    observer: Observer  # the subject
    twin: SimulatedLightBox  # the box
    channels: tuple[str, ...] = ("spot", "spot_red", "spot_green")  # the channels that it watches for
    filter_density: float = 0.0  # optical density of the filter before the test spot
    # Positions of channels that have a separate opening, without the filter, in degrees temporal of and above the mark;
    # the others are the test spot
    places: dict[str, tuple[float, float]] = field(default_factory=dict)
    leaves_after_min: float = math.inf  # time in the dark after which it presses no more
    taps: bool = False  # press again and again, whatever is seen
    answered: int = 0  # how often it has pressed for a light
    _lit: dict[str, bool] = field(default_factory=dict)
    _rested: Eye = field(init=False)
    _bleach: tuple[str, float, float, float, bool] | None = None
    _flashes: int = 0
    _bleached: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rods, cones, at which time in s

    def __post_init__(self) -> None:
        self._rested = self.observer.eye

    def dilate(self, pupil_mm: float | None) -> None:
        """Give the eye a pupil of a diameter in mm, as a protocol wants it; None leaves it as it is."""
        if pupil_mm is not None:
            self._rested = self.observer.eye = replace(self.observer.eye, pupil_mm=pupil_mm)

    def sit_down(self) -> None:
        """Begin to watch the box."""
        self.twin.watch = self._look
        begin_s, habits = self.twin.time_s, self.observer.habits
        self.observer.habits = replace(habits, false_alarms=0.0)
        if self.taps:
            errors = np.arange(begin_s, begin_s + LONGEST_S, TAPPING_S)
        else:
            count = self.observer.rng.poisson(habits.false_alarms * LONGEST_S)
            errors = np.sort(self.observer.rng.uniform(begin_s, begin_s + LONGEST_S, count))
        for time_s in errors:
            self._press(float(time_s))

    def _look(self) -> None:
        """See what has come on or gone off; press if the spot was noticed."""
        self._watch_bleach()
        self._watch_flash()
        for channel in self.channels:
            lit = self.twin.duty(channel) > 0
            came_on = lit and not self._lit.get(channel, False)
            self._lit[channel] = lit
            if came_on and not self.taps:
                self._answer(channel)

    def _answer(self, channel: str) -> None:
        time_s = self.twin.time_s
        if time_s - self.observer.dark_since_s > 60.0 * self.leaves_after_min:
            return
        emission = self._led(channel).emission(time_s)
        wavelength_nm = emission.peak_nm or 555.0
        place = self.places.get(channel)
        density = self.filter_density if place is None else 0.0
        luminance = emission.radiance_w_sr_m2 * scotopic_lm_per_w(wavelength_nm) * 10.0**-density
        reaction_s = self.observer.answer(math.log10(max(luminance, 1e-12)), time_s, wavelength_nm, place)
        if reaction_s is not None:
            self.answered += 1
            self._press(time_s + reaction_s)

    def _press(self, time_s: float) -> None:
        self.twin.press(time_s)
        self.twin.press(time_s + HOLD_S, pressed=False)

    def _watch_bleach(self) -> None:
        """Note when the bleaching light comes on, and adapt from when it has gone."""
        now_s = self.twin.time_s
        lit = next((name for name in BLEACHES if name in self._names and self.twin.duty(name) > 0), None)
        if lit is not None:
            if self._bleach is None:
                high = next(state.high for state in self.twin.channels if state.limits.name == lit)
                first = self._led(lit).emission(now_s).radiance_w_sr_m2
                self._bleach = lit, now_s, first, self.twin.duty(lit), high
            return
        if self._bleach is None:
            return
        name, begun_s, first, duty, high = self._bleach
        self._bleach = None
        led = copy(self._led(name))
        led.drive(duty, high=high, time_s=now_s)  # as it was just before: warm, hence a little dimmer than at first
        luminance = BOX_WHITE_LM_PER_W * 0.5 * (first + led.emission(now_s).radiance_w_sr_m2)
        self.observer.eye = eye_after_bleach(self._rested, luminance, now_s - begun_s)
        self.observer.dark_since_s = now_s

    def _watch_flash(self) -> None:
        """Be bleached by each flash, on top of the remaining bleach of those before."""
        while self._flashes < len(self.twin.flash.fired_ms):
            self._flashes += 1
            now_s = self.twin.time_s
            td_s = BOX_WHITE_LM_PER_W * self.twin.flash.exposure_j_sr_m2 * math.pi / 4 * self._rested.pupil_mm**2
            rods, cones, since_s = self._bleached
            rods, cones = pigments_after_flash(rods, cones, now_s - since_s, td_s)
            self._bleached = rods, cones, now_s
            self.observer.eye = eye_of_pigments(self._rested, rods, cones)
            self.observer.dark_since_s = now_s

    @property
    def _names(self) -> list[str]:
        return [limits.name for limits in self.twin.settings.channels]

    def _led(self, channel: str) -> LedState:
        return self.twin.leds[self._names.index(channel)]
