"""Protocol of a test: bleach, test spot, method, end; read from YAML and checked."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from radiometer.data.bleaching_constants import CONE_HALF_BLEACH, CONE_REGENERATION, ROD_EXPOSURE, ROD_REGENERATION
from radiometer.data.guards import safe_name
from radiometer.data.json_text import json_text
from radiometer.data.storage import read_yaml, shipped_config
from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import ConfigurationError, InputError, UsageError

Receptor = Literal["rods", "cones"]


@dataclass(frozen=True, slots=True)
class PigmentKinetics:
    """Kinetics of bleaching and regeneration of a receptor's pigment."""

    td_s: float  # retinal exposure Q_e in troland·s that leaves 1/e of the pigment
    regeneration_s: float  # time constant of regeneration in s


# Rods count scotopic trolands, cones photopic ones.
KINETICS: Final[dict[Receptor, PigmentKinetics]] = {
    "rods": PigmentKinetics(ROD_EXPOSURE.value, ROD_REGENERATION.value),
    "cones": PigmentKinetics(CONE_HALF_BLEACH.value * CONE_REGENERATION.value, CONE_REGENERATION.value),
}


def _extremes(receptor: Receptor) -> tuple[PigmentKinetics, ...]:
    """Return the kinetics at all ends of the published spread."""
    if receptor == "rods":
        ends = product((ROD_EXPOSURE.low, ROD_EXPOSURE.high), (ROD_REGENERATION.low, ROD_REGENERATION.high))
        return tuple(PigmentKinetics(td_s, time_s) for td_s, time_s in ends)
    ends = product((CONE_HALF_BLEACH.low, CONE_HALF_BLEACH.high), (CONE_REGENERATION.low, CONE_REGENERATION.high))
    return tuple(PigmentKinetics(half_td * time_s, time_s) for half_td, time_s in ends)


def pupil_diameter_mm(luminance_cd_m2: float, field_deg2: float = 100.0, age_years: float = 28.58) -> float:
    """Return the diameter of the natural pupil in mm under a field's luminance.

    Args:
        luminance_cd_m2: Luminance of the adapting field in cd·m⁻², 0 or more.
        field_deg2: Area of the field in square degrees.
        age_years: Age, 20 to 83.

    Source: Watson and Yellott 2012, Journal of Vision 12(10):12, equation (21), on Stanley and Davies 1995.
    """
    flux = float((luminance_cd_m2 * field_deg2 / 846.0) ** 0.41)
    young = 7.75 - 5.75 * flux / (flux + 2.0)
    return young + (age_years - 28.58) * (0.02132 - 0.009562 * young)


def retinal_illuminance_td(luminance_cd_m2: float, pupil_mm: float) -> float:
    """Return the retinal illuminance in trolands: luminance times the pupil's area in mm²."""
    return luminance_cd_m2 * math.pi / 4.0 * pupil_mm**2


def bleached_fraction(
    retinal_td: float, duration_s: float, receptor: Receptor = "rods", *, before: float = 0.0
) -> float:
    """Return the fraction of pigment that is bleached at the end of a steady light.

    dB/dt = (1 − B)·I/Q_e − B/τ, solved for constant I.

    Args:
        retinal_td: Retinal illuminance I in trolands, 0 or more: scotopic for rods, photopic for cones.
        duration_s: Duration in s, 0 or more.
        before: Fraction bleached when it begins.

    Source: Rushton and Henry 1968, Vision Research 8, 617; first-order kinetics.
    """
    return _fraction(KINETICS[receptor], retinal_td, duration_s, before)


def bleached_range(retinal_td: float, duration_s: float, receptor: Receptor = "rods") -> tuple[float, float]:
    """Return the least and the most that a steady light bleaches by any of the published constants.

    Args:
        retinal_td: Retinal illuminance in trolands, 0 or more.
        duration_s: Duration in s, 0 or more.
    """
    fractions = [_fraction(kinetics, retinal_td, duration_s, 0.0) for kinetics in _extremes(receptor)]
    return min(fractions), max(fractions)


def _fraction(kinetics: PigmentKinetics, retinal_td: float, duration_s: float, before: float) -> float:
    rate = retinal_td / kinetics.td_s + 1.0 / kinetics.regeneration_s
    steady = retinal_td / kinetics.td_s / rate
    return steady + (before - steady) * math.exp(-rate * duration_s)


SHIPPED = ("classic", "classic-blue", "rapid", "quick", "led-only", "questplus", "steady-low", "screen-only")
BLEACH_CHANNEL = "bleach"
PRACTICE_MIN = 3.0  # about ten thresholds and five catches: enough to see whether the task is understood
PRACTICE_CATCHES = 0.3
# Conditions of the published rod intercept at 5·10⁻³ scotopic cd·m⁻²: spot of about 2°, 500 to 510 nm, 5° from
# fixation. The bleach covered three quarters to four fifths of the rods (Jackson and Edwards 2008; Jackson et al. #
# 2014).
RIT_SIZE_DEG = (1.5, 2.5)
RIT_PEAK_NM = (500.0, 510.0)
RIT_ECCENTRICITY_DEG = (4.0, 6.0)
RIT_BLEACHED = (0.76, 0.82)
WHITE_SCOTOPIC_RATIO = 1.72  # of the white LED `white_led`; the check before a run takes the named spectrum's


class SteadyBleach(ConfigSection):
    """A bright field looked at for some time, by a channel of the box; the pupil is stated where it is dilated."""

    kind: Literal["steady"] = "steady"
    luminance_cd_m2: float = Field(gt=0, le=10_000)
    duration_s: float = Field(gt=0, le=600)
    channel: str = BLEACH_CHANNEL
    pupil_mm: float | None = Field(None, ge=1, le=9)

    def rods_bleached(self) -> float | None:
        """Return the fraction of the rods' pigment that it bleaches by the calculator; None without a stated pupil."""
        if self.pupil_mm is None:
            return None
        scotopic_td = WHITE_SCOTOPIC_RATIO * retinal_illuminance_td(self.luminance_cd_m2, self.pupil_mm)
        return bleached_fraction(scotopic_td, self.duration_s, "rods")


class FlashBleach(ConfigSection):
    """A flash, given by what reaches the retina in scotopic trolands × seconds through a pupil of known diameter.

    It must be short compared with the pigment's regeneration (400 s in rods), so that only its energy counts.
    The photographic flash at the box's trigger is `source: flash`, fired as often as the energy takes.
    """

    kind: Literal["flash"]
    retinal_td_s: float = Field(gt=0, le=1e8)
    duration_s: float = Field(0.01, gt=0, le=20.0)
    pupil_mm: float = Field(6.0, ge=1, le=9)
    channel: str = BLEACH_CHANNEL
    source: Literal["channel", "flash"] = "channel"

    def rods_bleached(self) -> float:
        """Return the fraction of the rods' pigment that it bleaches by the calculator."""
        return bleached_fraction(self.retinal_td_s / self.duration_s, self.duration_s, "rods")


class Spot(ConfigSection):
    """The test spot: where it is shown, its light, its place and how it blinks.

    Levels are log10 of scotopic luminance in cd·m⁻² at the eye, behind a neutral filter of `filter_density` before the
    spot where there is one.
    """

    device: Literal["screen", "light_box"]
    channel: str
    peak_nm: float = Field(gt=360, lt=780)
    size_deg: float = Field(1.5, gt=0, le=30)
    eccentricity_deg: float = Field(8.0, ge=0, le=60)
    on_s: float = Field(0.3, gt=0, le=10)
    off_s: float = Field(0.7, ge=0, le=60)
    filter_density: float = Field(0.0, ge=0, le=6)
    lowest_log10: float = Field(-5.5, ge=-8, le=5)
    highest_log10: float = Field(1.5, ge=-8, le=5)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.highest_log10 <= self.lowest_log10:
            raise ValueError("highest_log10 must be above lowest_log10")
        return self

    @property
    def cycle_s(self) -> float:
        """Return the time of one blink in s."""
        return self.on_s + self.off_s


class Fixation(ConfigSection):
    """The red mark that is looked at: red, for rods do not see it."""

    peak_nm: float = Field(660.0, gt=600, lt=780)
    size_deg: float = Field(0.3, gt=0, le=2)
    luminance_cd_m2: float = Field(0.1, gt=0, le=10)


class FixationCheck(ConfigSection):
    """A light in the blind spot, shown now and then: who sees it does not look at the mark (Heijl and Krakau 1975).

    It is red, as the mark: rods hardly see it, and the cones, once they are back, always do. The blind spot's middle is
    15.5° temporal of fixation and 1.5° below it, its size 5.5° by 7.5° (Armaly 1969).
    """

    share: float = Field(0.06, gt=0, le=0.3)  # share of the trials
    channel: str = "spot_red"  # channel of the box whose opening stands there; a screen shows it by its red
    temporal_deg: float = Field(15.5, ge=13.5, le=17.5)  # where it stands, temporal of the mark
    below_deg: float = Field(1.5, ge=-1.0, le=4.0)  # and below it
    size_deg: float = Field(1.0, gt=0, le=2.0)  # its diameter
    luminance_cd_m2: float = Field(0.1, gt=0, le=1)  # its luminance at the eye
    from_min: float = Field(4.0, ge=0, le=30)  # time in the dark from which it is shown
    # Share of lost fixation which, if it is certainly passed, leaves nothing to be fitted
    most_lost_share: float = Field(0.33, gt=0, le=1)


class ViewingDistance(ConfigSection):
    """Where the eye is before a screen; the screen's calibration may know its pixels."""

    distance_mm: float = Field(600.0, ge=50, le=5000)
    pixel_mm: float | None = Field(None, gt=0.01, le=5)


class LimitsMethod(ConfigSection):
    """Ascending limits: the blinking spot brightens by a step per blink until the button is pressed."""

    kind: Literal["limits"] = "limits"
    step_log10: float = Field(0.1, gt=0, le=1)
    start_below_log10: float = Field(0.5, gt=0, le=3)


class StaircaseMethod(ConfigSection):
    """4-2 dB staircase: dimmer after a press, brighter after none; the step halves at the first reversal."""

    kind: Literal["staircase"]
    first_step_log10: float = Field(0.4, gt=0, le=2)
    step_log10: float = Field(0.2, gt=0, le=1)
    reversals: int = Field(2, ge=1, le=10)
    start_below_log10: float = Field(0.2, gt=-1, le=3)


class DownUpMethod(ConfigSection):
    """Three down, one up: dimmer by three small steps while it is seen, then brighter by one until it is seen again.

    That level is the threshold; the next search begins `start_above_log10` brighter. (The staircase of the rapid tests,
    Jackson and Edwards 2008: 0.3 down, 0.1 up, 0.2 above.)
    """

    kind: Literal["down_up"]
    down_log10: float = Field(0.3, gt=0, le=2)
    up_log10: float = Field(0.1, gt=0, le=1)
    start_above_log10: float = Field(0.2, ge=0, le=2)


class QuestPlusMethod(ConfigSection):
    """QUEST+: each blink where it is most informative, until the threshold is known to `stop_sd_log10`.

    Levels are `step_log10` apart. The prior is a normal distribution around the last threshold. `slopes` are exponents
    of the Weibull function that are thought possible.
    """

    kind: Literal["questplus"]
    step_log10: float = Field(0.1, gt=0, le=0.5)
    prior_sd_log10: float = Field(0.5, gt=0, le=5)
    slopes: tuple[float, ...] = Field((2.5, 3.5, 5.0), min_length=1)
    false_alarms: float = Field(0.01, ge=0, lt=0.5)
    lapses: float = Field(0.02, ge=0, lt=0.5)
    stop_sd_log10: float = Field(0.1, gt=0, le=1)
    least_blinks: int = Field(4, ge=1, le=1000)
    most_blinks: int = Field(25, ge=2, le=1000)


class Ending(ConfigSection):
    """When the test is over."""

    duration_min: float = Field(40.0, gt=0, le=120)
    criterion_log10: float | None = None
    beyond: int = Field(1, ge=1, le=10)  # thresholds in a row below the criterion that end the test


class Intercept(ConfigSection):
    """The rod intercept that a protocol reports: the time at which the threshold meets a criterion, and its limit."""

    criterion_log10: float
    limit_min: float = Field(gt=0)
    source: str


class Watch(ConfigSection):
    """How false presses, lapses, absence and the wish for a pause are found out.

    `catch_share` of the trials have no spot, `lapse_share` one ten times above the last threshold, which only those
    miss who do not attend.
    A press that is held for `hold_to_pause_s` asks for a pause. A trial is given up after `most_blinks`; after
    `absent_after` trials without a threshold, or a pause of more than `longest_pause_min`, the test is over. In the
    first `blind_min` after the bleach nothing may be seen: unanswered trials count only later.
    """

    catch_share: float = Field(0.1, ge=0, le=0.5)
    lapse_share: float = Field(0.04, ge=0, le=0.2)
    fastest_press_s: float = Field(0.12, ge=0, le=1)
    pause_between_s: float = Field(4.0, ge=0, le=600)
    hold_to_pause_s: float = Field(2.0, gt=0, le=30)
    longest_pause_min: float = Field(10.0, gt=0, le=60)
    blind_min: float = Field(5.0, ge=0, le=30)
    most_blinks: int = Field(90, ge=5, le=1000)
    absent_after: int = Field(3, ge=1, le=100)
    most_false_share: float = Field(0.33, gt=0, le=1)


class Safety(ConfigSection):
    """Limits that the run keeps to."""

    darkest_room_cd_m2: float = Field(1e-3, gt=0, le=10)  # the most that the dark room may have
    calibration_days: float = Field(30.0, gt=0, le=3660)  # the greatest age of the calibration of box or screen


class AdaptationProtocol(ConfigSection):
    """A whole protocol."""

    format: Literal["radiometer-protocol/1"] = "radiometer-protocol/1"
    name: str
    description: str = ""
    bleach: Annotated[SteadyBleach | FlashBleach, Field(discriminator="kind")]
    spot: Spot
    fixation: Fixation = Fixation()
    fixation_check: FixationCheck | None = None
    viewing: ViewingDistance = ViewingDistance()
    method: Annotated[LimitsMethod | StaircaseMethod | DownUpMethod | QuestPlusMethod, Field(discriminator="kind")]
    end: Ending = Ending()
    intercept: Intercept | None = None
    shows: Literal["break", "recovery"] = "break"
    watch: Watch = Watch()
    safety: Safety = Safety()

    def content_hash(self) -> str:
        """Return a hash of all that it asks for: equal means the same test."""
        return hashlib.sha256(json_text(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()[:16]

    @field_validator("name")
    @classmethod
    def _name_stays_in_its_folder(cls, name: str) -> str:
        """Refuse a name that is none of a file: the journal of a run carries it."""
        try:
            return safe_name(name, "name")
        except UsageError as error:
            raise ValueError(str(error)) from None

    @model_validator(mode="after")
    def _criterion_within_reach(self) -> Self:
        criterion = self.end.criterion_log10
        if criterion is not None and not self.spot.lowest_log10 < criterion < self.spot.highest_log10:
            raise ValueError("end.criterion_log10 is outside the spot's levels")
        return self

    @model_validator(mode="after")
    def _intercept_belongs(self) -> Self:
        """Refuse a rod intercept where criterion, spot or bleach are not those for which it was published."""
        if self.intercept is None:
            return self
        spot, bleached = self.spot, self.bleach.rods_bleached()
        found = {
            "intercept.criterion_log10": (10.0**self.intercept.criterion_log10, (0.0049, 0.0051)),
            "spot.size_deg": (spot.size_deg, RIT_SIZE_DEG),
            "spot.peak_nm": (spot.peak_nm, RIT_PEAK_NM),
            "spot.eccentricity_deg": (spot.eccentricity_deg, RIT_ECCENTRICITY_DEG),
            "bleached rods": (-1.0 if bleached is None else bleached, RIT_BLEACHED),
        }
        for name, (value, (low, high)) in found.items():
            if not low <= value <= high:
                raise ValueError(
                    f"intercept: its limit holds for {name} of {low:g} to {high:g}, not {value:.3g}; "
                    "leave `intercept` out"
                )
        return self


def practice_of(protocol: AdaptationProtocol) -> AdaptationProtocol:
    """Return a protocol's practice run: the same spot and method for a few minutes, with a third of catches."""
    return protocol.model_copy(
        update={
            "name": f"{protocol.name}-practice",
            "shows": "recovery",
            "intercept": None,
            "end": Ending(duration_min=PRACTICE_MIN),
            "watch": protocol.watch.model_copy(update={"catch_share": PRACTICE_CATCHES, "blind_min": 0.0}),
        }
    )


def read_protocol(name: str | Path) -> AdaptationProtocol:
    """Return the protocol in a file, or a shipped one by its name.

    Raises:
        ConfigurationError: If there is none, or it holds something not allowed.
    """
    file = Path(name)
    if str(name) in SHIPPED and not file.exists():
        file = shipped_config(f"protocols/{name}.yaml")
    try:
        mapping = read_yaml(file)
    except InputError as error:
        raise ConfigurationError(f"{error}; shipped protocols are {', '.join(SHIPPED)}") from error
    return validate(AdaptationProtocol, mapping, str(file), ConfigurationError)


def instructions(protocol: AdaptationProtocol) -> list[str]:
    """Return what a subject must know, a sentence or two each, in the order of the test."""
    bleach, watch, minutes = protocol.bleach, protocol.watch, protocol.end.duration_min
    light = (
        "You look straight into a flash of light."
        if isinstance(bleach, FlashBleach) and bleach.source == "flash"
        else f"First you look into a bright field for {_span(bleach.duration_s)}. Keep your eye open; you may blink."
    )
    whole_min = round(bleach.duration_s / 60 + minutes)
    sentences = [
        f"This test finds how your eye gets used to the dark. It takes about {whole_min} minutes. "
        "You may end it at any time.",
        light,
        "Then it is dark. Look at the small red mark all the time, also while you wait.",
        f"To the side of the mark a spot blinks, for {protocol.spot.on_s:g} s each time. "
        "Press the button as soon as you notice it, however faint. Do not look at the spot.",
        "Press only when you see a light. Now and then nothing is shown, to find out how often the button is pressed "
        "by mistake.",
    ]
    if protocol.fixation_check is not None:
        sentences.append(
            "Now and then a red light is shown where you cannot see it as long as you look at the mark. "
            "If you see a red light, press, and look at the mark again."
        )
    sentences += [
        f"At first you may see nothing for up to {watch.blind_min:g} minutes. "
        "That is normal: your eye recovers from the bright light.",
        f"If you need a pause, hold the button for {watch.hold_to_pause_s:g} s. Press once to go on. "
        f"In the pause stay in the dark; after {watch.longest_pause_min:g} minutes the test ends.",
    ]
    if bleach.pupil_mm is not None:
        sentences.append(
            f"(For the operator: the protocol counts on a pupil of {bleach.pupil_mm:g} mm. "
            "Measure it in the dark, state it with --pupil, and cover the other eye.)"
        )
    return sentences


def _span(seconds: float) -> str:
    return f"{seconds:g} seconds" if seconds < 90 else f"{seconds / 60:g} minutes"
