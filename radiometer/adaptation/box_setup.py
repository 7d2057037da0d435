"""The light box as a stage of the adaptation test, with its checks; a simulated subject may sit before it."""

from __future__ import annotations

import datetime as dt
import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.adaptation.checks import Check, Finding, judge_age, measured_room
from radiometer.adaptation.protocol import AdaptationProtocol, FlashBleach, SteadyBleach
from radiometer.adaptation.request import SIMULATED_BOX, RunRequest
from radiometer.adaptation.run import Stage
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.bench.boxes import OpenedBox, open_light_box
from radiometer.bench.light_bench import open_light_camera
from radiometer.bench.served import places_of, seat_subject
from radiometer.data.storage import shipped_config
from radiometer.devices.light_box import ButtonEvent, FlashBox, LightBox, Radiance
from radiometer.devices.retinal_safety import HazardFractions
from radiometer.errors import (
    CalibrationError,
    DeviceError,
    MeasurementError,
    RadiometerError,
    SettingOutOfRange,
    UsageError,
)

SIMULATED_CALIBRATION: Final = "calibrations/simulated-box.yaml"
PEAK_TOLERANCE_NM: Final = 10.0  # bin of LEDs: ± 5 to 10 nm; rods change by less than 10 % within it near 500 nm
PLACE_TOLERANCE_DEG: Final = 1.0  # spots are 1.5 to 2.5° wide
FIXATION = "fixation"
_LOOK_S = 0.25  # how often a bleach looks whether it was ended
_CLOCK_REL = 0.02  # twice the rate beyond which the clock of a box is given up
FLASH_GAP_S = 10.0  # between two photographic flashes: the box wants 5 s, the flash charges


@dataclass(frozen=True, slots=True)
class BoxLights:
    """What the eye makes of the box's light, and what of it the protocol wants."""

    protocol: AdaptationProtocol  # the protocol
    bleach_photopic_lm_per_w: float  # luminous efficacy of the bleaching light
    bleach_scotopic_lm_per_w: float  # its scotopic luminous efficacy
    spot_scotopic_lm_per_w: float  # that of the spot's light
    fixation_w_sr_m2: float = 0.0  # radiance of the fixation mark; 0 leaves it dark
    u_scale_log10: float = 0.0  # standard uncertainty that all levels of the spot share, in log10 units
    blind_spot_w_sr_m2: float = 0.0  # radiance of the light in the blind spot; 0 where this box has none there
    no_fixation_check: str = ""  # why it has none, for the journal

    @property
    def bleach(self) -> Radiance:
        """Return the radiance of the bleach; a flash's is its td·s over duration and area of the pupil in mm²."""
        light = self.protocol.bleach
        if isinstance(light, SteadyBleach):
            return Radiance(light.luminance_cd_m2 / self.bleach_photopic_lm_per_w)
        trolands = light.retinal_td_s / light.duration_s
        return Radiance(trolands / (math.pi / 4 * light.pupil_mm**2) / self.bleach_scotopic_lm_per_w)

    def flashes(self, exposure_j_sr_m2: float) -> int:
        """Return how many photographic flashes of a radiant exposure give the protocol's td·s, to the nearest one."""
        light = self.protocol.bleach
        assert isinstance(light, FlashBleach)
        td_s = exposure_j_sr_m2 * self.bleach_scotopic_lm_per_w * math.pi / 4 * light.pupil_mm**2
        return max(1, round(light.retinal_td_s / td_s))

    @property
    def by_flash(self) -> bool:
        """Return whether the photographic flash bleaches."""
        return isinstance(self.protocol.bleach, FlashBleach) and self.protocol.bleach.source == "flash"

    def spot(self, log10_level: float) -> Radiance:
        """Return the radiance of the spot, before its filter, for a level in log10 scotopic cd·m⁻² behind it."""
        density = self.protocol.spot.filter_density
        return Radiance(10.0 ** (log10_level + density) / self.spot_scotopic_lm_per_w)


@dataclass(slots=True)
class BoxStage(Stage):
    """Runs a test on an open light box, in real time."""

    box: LightBox  # an open light box with calibrated channels
    lights: BoxLights  # its lights
    clock: Callable[[], float]  # steady clock in s, the one that the box's button events are given on
    sleep: Callable[[float], None]  # waits for a number of seconds
    wall_clock: Callable[[], float] | None = None  # time of day as Unix time in s; None where the box is simulated
    ended: Callable[[], bool] = lambda: False  # whether the end of the test is asked for
    protocol: AdaptationProtocol = field(init=False)
    _zero_s: float = field(default=0.0, init=False)
    _pressed_s: float | None = field(default=None, init=False)
    _longest: tuple[float, float] = field(default=(0.0, 0.0), init=False)

    def __post_init__(self) -> None:
        self.protocol, self._zero_s = self.lights.protocol, self.clock()

    def now_s(self) -> float:
        return self.clock() - self._zero_s

    def wall_s(self) -> float | None:
        return self.wall_clock() if self.wall_clock else None

    def resume_at(self, time_s: float) -> None:
        self._zero_s = self.clock() - time_s
        self._light_mark()

    def facts(self) -> dict[str, str | float]:
        known: dict[str, str | float] = {
            "box": self.box.identity.serial,
            "firmware": self.box.identity.firmware,
            "u_scale_log10": round(self.lights.u_scale_log10, 4),
            "fixation_w_sr_m2": float(f"{self.lights.fixation_w_sr_m2:.6g}"),
        }
        if self.lights.no_fixation_check:
            known["no_fixation_check"] = self.lights.no_fixation_check
        return known

    def health(self) -> dict[str, str]:
        if self.wall_clock is None:  # asking would let simulated time pass
            return {"box": self.box.identity.serial}
        now = self.box.status()
        return {
            "box": self.box.identity.serial,
            "supply": f"{now.supply_v:.2f} V",
            "temperature": f"{now.temperature_celsius:.0f} °C",
            "went dark by itself": f"{now.darkened} times",
        }

    def bleach(self, protocol: AdaptationProtocol) -> None:
        if self.lights.by_flash:
            self._flash()
        else:
            self.box.pulse(protocol.bleach.channel, self.lights.bleach, protocol.bleach.duration_s)
            self._sleep_while_on(protocol.bleach.channel, protocol.bleach.duration_s)
            if self.ended():
                self.box.off(protocol.bleach.channel)
                return
        self._light_mark()

    @property
    def switched_off(self) -> bool:
        """Return whether another program has switched the lights off: none is lit again."""
        return bool(getattr(self.box, "switched_off", False))

    def _sleep_while_on(self, channel: str, duration_s: float) -> None:
        """Wait while a channel is lit, in real time until the lights are switched off or the test is ended at most."""
        slice_s, end_s = duration_s if self.wall_clock is None else _LOOK_S, self.clock() + duration_s
        while (left_s := end_s - self.clock()) > 0.0 and not (self.switched_off or self.ended()):
            self.sleep(min(left_s, slice_s))
            if self.wall_clock is None or self.switched_off:
                continue
            left_s = end_s - self.clock()
            # A box whose clock is fast by as much as one may be ends its light before.
            if left_s > _LOOK_S + _CLOCK_REL * duration_s and self.box.read_channel(channel).drive.level == 0:
                raise DeviceError(
                    f"the light box ended the bleach by itself, about {left_s:.0f} s too early: its energy budget is"
                    " used up, or its button was held for 3 s. Let the eye recover, then begin a new visit"
                )

    def _flash(self) -> None:
        if not isinstance(self.box, FlashBox):
            raise UsageError("the protocol bleaches by a photographic flash, which this light box has not")
        count = self.lights.flashes(self.box.flash_exposure_j_sr_m2)
        for number in range(count):
            self.box.fire_flash()
            self.sleep(FLASH_GAP_S if number < count - 1 else 0.1)

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        light = None if log10_level is None else self.lights.spot(log10_level)
        return self._blink_once(self.protocol.spot.channel, light)

    @property
    def checks_fixation(self) -> bool:
        return self.protocol.fixation_check is not None and self.lights.blind_spot_w_sr_m2 > 0

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        check = self.protocol.fixation_check
        if check is None or not self.checks_fixation:
            return super(BoxStage, self).blink_blind_spot(trial, number)
        return self._blink_once(check.channel, Radiance(self.lights.blind_spot_w_sr_m2))

    def _blink_once(self, channel: str, light: Radiance | None) -> list[float]:
        """Light a channel for the protocol's time (None: nothing) and return the presses until the cycle is over."""
        spot, onset = self.protocol.spot, self.clock()
        if light is not None and not self.switched_off:
            self.box.pulse(channel, light, spot.on_s)
        presses = self._presses(self.box.buttons(max(0.0, spot.cycle_s - (self.clock() - onset))))
        return [time_s - onset for time_s in presses if time_s >= onset]

    def rest(self, seconds: float) -> int:
        return len(self._presses(self.box.buttons(seconds)))

    def long_press(self, at_least_s: float) -> float | None:
        begun_s, held_s = self._longest
        if self._pressed_s is not None and self.clock() - self._pressed_s > held_s:
            begun_s, held_s = self._pressed_s, self.clock() - self._pressed_s
        if held_s < at_least_s:
            return None
        self._longest, self._pressed_s = (0.0, 0.0), None
        return begun_s - self._zero_s

    def _presses(self, events: Iterable[ButtonEvent]) -> list[float]:
        """Return when presses began, on the box's clock, and remember the longest that has ended."""
        presses = []
        for event in events:
            if event.pressed:
                self._pressed_s = event.time_s
                presses.append(event.time_s)
            elif self._pressed_s is not None:
                held_s = event.time_s - self._pressed_s
                self._longest = max(self._longest, (self._pressed_s, held_s), key=lambda press: press[1])
                self._pressed_s = None
        return presses

    def _light_mark(self) -> None:
        if self.lights.fixation_w_sr_m2 and not self.switched_off:
            self.box.set_level(FIXATION, Radiance(self.lights.fixation_w_sr_m2))


@contextmanager
def open_box_stage(request: RunRequest) -> Iterator[tuple[BoxStage, list[Check]]]:
    """Open a light box as a stage for the block, with its checks; it is dark and released afterwards.

    Raises:
        UsageError: If the protocol wants a screen, or a simulated subject is to sit before a real box.
        CalibrationError: If the box has no calibration, or another box's.
        DeviceError: If the box cannot be opened.
        InputError: If the spectrum is unknown.
    """
    protocol = request.protocol
    if protocol.spot.device != "light_box":
        raise UsageError(f"protocol {protocol.name} shows its spot on a screen; choose one for the light box")
    if request.simulate is not None and request.box != SIMULATED_BOX:
        raise UsageError("a simulated subject can only sit before the simulated box: --box sim")
    own = request.box == SIMULATED_BOX and request.calibration is None
    file = shipped_config(SIMULATED_CALIBRATION) if own else request.calibration
    with open_light_box(request.box, calibration=file, preset=request.preset, eye=request.whose) as opened:
        if opened.calibration is None:
            raise CalibrationError(
                f"light box {opened.box.identity.serial} has no calibration: make one with `radiometer light calibrate`"
            )
        if opened.twin is not None and request.simulate is not None:
            seated = seat_subject(opened.twin, request.simulate, request.seed, protocol.spot.filter_density)
            seated.places = places_of(opened.config)
            seated.dilate(protocol.bleach.pupil_mm)
        lights = _lights(request, opened)
        clock = opened.box.link.line.now  # the clock that the button's times are given on
        stage = BoxStage(opened.box, lights, clock, opened.wait, None if opened.twin else time.time)
        yield stage, _checks(opened, lights, request, shipped=own)


def _lights(request: RunRequest, opened: OpenedBox) -> BoxLights:
    """Return what the eye makes of the box's lights. Raises InputError for an unknown spectrum."""
    protocol = request.protocol
    white, spot = spectrum(request.white), spectrum(f"line:{protocol.spot.peak_nm:g}")
    mark_w_sr_m2 = request.fixation_w_sr_m2
    if mark_w_sr_m2 is None:
        mark_w_sr_m2 = _red_w_sr_m2(protocol, opened, FIXATION, protocol.fixation.luminance_cd_m2)
    missing, check, unseen = _no_blind_spot(protocol, opened), protocol.fixation_check, 0.0
    if check is not None and missing is None:
        unseen = _red_w_sr_m2(protocol, opened, check.channel, check.luminance_cd_m2)
    spot_levels = opened.calibration.channels.get(protocol.spot.channel) if opened.calibration else None
    return BoxLights(
        protocol,
        luminous_efficacy_lm_per_w(white, "photopic"),
        luminous_efficacy_lm_per_w(white, "scotopic"),
        luminous_efficacy_lm_per_w(spot, "scotopic"),
        mark_w_sr_m2,
        0.0 if spot_levels is None else spot_levels.common_u_rel / math.log(10.0),
        unseen,
        missing or "",
    )


def _no_blind_spot(protocol: AdaptationProtocol, opened: OpenedBox) -> str | None:
    """Return why the box cannot check fixation as the protocol wants; None where it can."""
    check = protocol.fixation_check
    if check is None:
        return "the protocol has no fixation_check"
    stated = opened.config.channels.get(check.channel)
    place = stated.place if stated else None
    if place is None:
        return f"the preset states no `place` for channel {check.channel}"
    apart_deg = math.hypot(place.temporal_deg - check.temporal_deg, place.below_deg - check.below_deg)
    if apart_deg > PLACE_TOLERANCE_DEG:
        return (
            f"channel {check.channel} is {place.temporal_deg:g}° temporal and {place.below_deg:g}° below the mark, "
            f"the protocol needs {check.temporal_deg:g}° and {check.below_deg:g}°"
        )
    if opened.calibration is None or check.channel not in opened.calibration.channels:
        return f"channel {check.channel} has no calibration"
    return None


def _red_w_sr_m2(protocol: AdaptationProtocol, opened: OpenedBox, channel: str, luminance_cd_m2: float) -> float:
    """Return the radiance of a luminance at a red channel's wavelength: its own where known, else the protocol's."""
    known = opened.box.channels.get(channel)
    peak_nm = known.peak_nm if known and known.peak_nm else protocol.fixation.peak_nm
    return luminance_cd_m2 / luminous_efficacy_lm_per_w(spectrum(f"line:{peak_nm:g}"))


def _checks(opened: OpenedBox, lights: BoxLights, request: RunRequest, *, shipped: bool) -> list[Check]:
    checks: list[Check] = [lambda: _safe(opened, lights)]
    if not shipped:  # the simulated box does not age
        checks.append(lambda: _young(opened, request))
    if request.measure_room:
        checks.append(lambda: _dark(opened, request))
    return checks


def _young(opened: OpenedBox, request: RunRequest) -> Finding:
    assert opened.calibration is not None
    what, now = f"light box {opened.calibration.box_serial}", dt.datetime.now(dt.UTC)
    return judge_age(what, opened.calibration.created, request.protocol, now, accept_stale=request.accept_stale)


def _dark(opened: OpenedBox, request: RunRequest) -> Finding:
    """Return what the camera reads of the dark field. Raises DeviceError, CalibrationError, UsageError."""
    opened.box.safe()
    ambient_w_sr_m2 = request.room_cd_m2 / luminous_efficacy_lm_per_w(spectrum(request.white), "photopic")
    with open_light_camera(opened, request.camera, request.bench, None, None, ambient_w_sr_m2) as instrument:
        return measured_room(instrument, request.protocol, request.white)


def _safe(opened: OpenedBox, lights: BoxLights) -> Finding:
    """Return what the whole test does to the eye, with every light at its highest, and whether the box can give it."""
    protocol, box = lights.protocol, opened.box
    bright_s = 60 * protocol.end.duration_min
    spot, share = protocol.spot, protocol.spot.on_s / protocol.spot.cycle_s
    facts: dict[str, object] = {"what": "safety", "allowed_fraction": box.ledger.allowed_fraction}
    try:
        _require_colour(opened, protocol)
        used = [_bleach_used(opened, lights)]
        box.foresee(spot.channel, lights.spot(spot.lowest_log10), spot.on_s)
        used.append(box.foresee(spot.channel, lights.spot(spot.highest_log10), share * bright_s))
        if lights.fixation_w_sr_m2:
            used.append(box.foresee(FIXATION, Radiance(lights.fixation_w_sr_m2), bright_s))
        check = protocol.fixation_check
        if check is not None and lights.blind_spot_w_sr_m2:
            blinking_s = share * check.share * bright_s
            used.append(box.foresee(check.channel, Radiance(lights.blind_spot_w_sr_m2), blinking_s))
        whole = HazardFractions(sum(one.blue_light for one in used), max(one.thermal for one in used))
        facts |= {"blue_light": float(f"{whole.blue_light:.3g}"), "thermal": float(f"{whole.thermal:.3g}")}
        facts["bleach_w_sr_m2"] = float(f"{lights.bleach.radiance_w_sr_m2:.5g}")
        box.ledger.refuse_further(f"protocol {protocol.name}", whole)
    except RadiometerError as refusal:
        return Finding("check", facts, _explained(refusal, opened, lights))
    return Finding("check", facts)


def _bleach_used(opened: OpenedBox, lights: BoxLights) -> HazardFractions:
    """Return what the bleach uses up of the exposure limits. Raises as the box's `foresee`."""
    bleach = lights.protocol.bleach
    if lights.by_flash:
        count, left = lights.flashes(opened.box.flash_exposure_j_sr_m2), opened.box.flash_state().left
        if count > left:
            raise MeasurementError(
                f"protocol {lights.protocol.name}: its bleach takes {count} flashes, the box fires {left} in a row: "
                "lower bleach.retinal_td_s, set the flash to more power (and state it in the preset), or wait for ten "
                "minutes"
            )
        return opened.box.foresee_flashes(count)
    return opened.box.foresee(bleach.channel, lights.bleach, bleach.duration_s)


def _require_colour(opened: OpenedBox, protocol: AdaptationProtocol) -> None:
    """Raise UsageError if the channel's light, or its place, is not the protocol's."""
    spot = protocol.spot
    stated = opened.config.channels.get(spot.channel)
    if stated is not None and stated.place is not None:
        apart = math.hypot(stated.place.temporal_deg, stated.place.below_deg)
        if abs(apart - spot.eccentricity_deg) > PLACE_TOLERANCE_DEG:
            raise UsageError(
                f"protocol {protocol.name} needs its spot {spot.eccentricity_deg:g}° from the mark, channel "
                f"{spot.channel} is {apart:.1f}° from it: name another channel, or a preset with its place"
            )
    known = opened.box.channels.get(spot.channel)
    peak_nm = known.peak_nm if known else None
    if peak_nm is not None and abs(peak_nm - spot.peak_nm) > PEAK_TOLERANCE_NM:
        raise UsageError(
            f"protocol {protocol.name} needs a spot of {spot.peak_nm:g} nm, channel {spot.channel} has {peak_nm:g} nm: "
            "name another channel, or state that wavelength in the protocol"
        )


def _explained(refusal: RadiometerError, opened: OpenedBox, lights: BoxLights) -> RadiometerError:
    """Return a refusal with the way out where the box cannot give what the protocol needs."""
    if not isinstance(refusal, SettingOutOfRange) or opened.calibration is None:
        return refusal
    protocol, spot = lights.protocol, lights.protocol.spot
    bleach = protocol.bleach
    if refusal.name.endswith(bleach.channel):
        _, brightest = opened.calibration.limits(bleach.channel)
        if isinstance(bleach, FlashBleach):
            shortest_s = bleach.duration_s * lights.bleach.radiance_w_sr_m2 / brightest
            way = f"this box needs {shortest_s:.3g} s at least for {bleach.retinal_td_s:g} td·s: bleach.duration_s"
        else:
            way = f"it reaches {brightest * lights.bleach_photopic_lm_per_w:.0f} cd·m⁻²: bleach.luminance_cd_m2"
    elif protocol.fixation_check is not None and refusal.name.endswith(protocol.fixation_check.channel):
        way = "choose another fixation_check.luminance_cd_m2"
    else:
        low, high = (
            np.log10(radiance * lights.spot_scotopic_lm_per_w) - spot.filter_density
            for radiance in opened.calibration.limits(spot.channel)
        )
        way = (
            f"behind a filter of density {spot.filter_density:g} it reaches {low:.2f} to {high:.2f} log₁₀ scotopic "
            "cd·m⁻²: spot.lowest_log10, spot.highest_log10 or spot.filter_density"
        )
    return MeasurementError(f"protocol {protocol.name}: {refusal}; {way}")
