"""A simulated subject before the simulated light box: sees its LEDs, is bleached by them, presses its button."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from simulators.light_box.box import SimulatedLightBox
from simulators.light_box.led_physics import LedState
from simulators.observers.eye_kinetics import (
    Eye,
    eye_after_bleach,
    eye_of_pigments,
    pigments_after_flash,
    scotopic_lm_per_w,
)
from simulators.observers.observer import Observer

HOLD_S: Final = 0.15  # how long the button is held
BLEACHES: Final = ("bleach", "field")
WHITE_LM_PER_W: Final = 320.0  # of a white LED's light: 450 nm pump, phosphor at 560 nm
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
        luminance = WHITE_LM_PER_W * 0.5 * (first + led.emission(now_s).radiance_w_sr_m2)
        self.observer.eye = eye_after_bleach(self._rested, luminance, now_s - begun_s)
        self.observer.dark_since_s = now_s

    def _watch_flash(self) -> None:
        """Be bleached by each flash, on top of the remaining bleach of those before."""
        while self._flashes < len(self.twin.flash.fired_ms):
            self._flashes += 1
            now_s = self.twin.time_s
            td_s = WHITE_LM_PER_W * self.twin.flash.exposure_j_sr_m2 * math.pi / 4 * self._rested.pupil_mm**2
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
