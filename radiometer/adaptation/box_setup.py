"""The light box as a stage of the adaptation test, with its checks; a simulated subject may sit before it."""

from __future__ import annotations

import datetime as dt
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from radiometer.adaptation.box_stage import FIXATION, BoxLights, BoxStage
from radiometer.adaptation.checks import Check, Finding, judge_age
from radiometer.adaptation.protocol import AdaptationProtocol, FlashBleach
from radiometer.adaptation.request import SIMULATED_BOX, RunRequest
from radiometer.adaptation.room import measured_room
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.bench.boxes import OpenedBox, open_light_box
from radiometer.bench.light_bench import open_light_camera
from radiometer.bench.seated_subject import places_of, seat_subject
from radiometer.data.config_files import shipped_config
from radiometer.devices.light_box import Radiance
from radiometer.devices.retinal_safety import HazardFractions
from radiometer.errors import CalibrationError, MeasurementError, RadiometerError, SettingOutOfRange, UsageError

SIMULATED_CALIBRATION: Final = "calibrations/simulated-box.yaml"
PEAK_TOLERANCE_NM: Final = 10.0  # bin of LEDs: ± 5 to 10 nm; rods change by less than 10 % within it near 500 nm
PLACE_TOLERANCE_DEG: Final = 1.0  # spots are 1.5 to 2.5° wide


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
        known = opened.box.channels.get(FIXATION)
        peak_nm = known.peak_nm if known and known.peak_nm else protocol.fixation.peak_nm
        mark_w_sr_m2 = protocol.fixation.luminance_cd_m2 / luminous_efficacy_lm_per_w(spectrum(f"line:{peak_nm:g}"))
    missing = _no_blind_spot(protocol, opened)
    spot_levels = opened.calibration.channels.get(protocol.spot.channel) if opened.calibration else None
    return BoxLights(
        protocol,
        luminous_efficacy_lm_per_w(white, "photopic"),
        luminous_efficacy_lm_per_w(white, "scotopic"),
        luminous_efficacy_lm_per_w(spot, "scotopic"),
        mark_w_sr_m2,
        0.0 if spot_levels is None else spot_levels.common_u_rel / math.log(10.0),
        0.0 if missing is not None else _blind_spot_w_sr_m2(protocol, opened),
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


def _blind_spot_w_sr_m2(protocol: AdaptationProtocol, opened: OpenedBox) -> float:
    """Return the radiance of the light in the blind spot: the protocol's luminance at the channel's wavelength."""
    check = protocol.fixation_check
    if check is None:
        return 0.0
    known = opened.box.channels.get(check.channel)
    peak_nm = known.peak_nm if known and known.peak_nm else protocol.fixation.peak_nm
    return check.luminance_cd_m2 / luminous_efficacy_lm_per_w(spectrum(f"line:{peak_nm:g}"))


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
