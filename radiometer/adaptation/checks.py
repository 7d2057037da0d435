"""Checks before a bleach: calibration not too old, light safe, room dark. Each finding is journalled."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.request import RunRequest
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.bench.assembly import open_instrument
from radiometer.bench.instrument import Instrument
from radiometer.data.provenance import is_out_of_date
from radiometer.errors import CalibrationError, MeasurementError, RadiometerError
from radiometer.moments import moment_of
from radiometer.numbers import with_u

COVERAGE: Final = 2.0  # k for 95 %: the room must be dark enough with its uncertainty


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check has found."""

    kind: str  # kind of the event: "room" or "check"
    facts: Mapping[str, Any]  # what is written to the journal
    refusal: RadiometerError | None = None  # why the test must not begin; None where it may


Check = Callable[[], Finding]


def judge_age(
    what: str, created: str, protocol: AdaptationProtocol, now: dt.datetime, *, accept_stale: bool = False
) -> Finding:
    """Return whether a calibration is young enough for a protocol.

    Args:
        created: When, ISO 8601 with time zone.
        accept_stale: Go on with an old one; the journal says so.
    """
    try:
        age_days = (now - moment_of(created)).total_seconds() / 86400.0
    except (ValueError, TypeError):
        message = f"the calibration of {what} says {created!r} for when it was made; calibrate again"
        return Finding("check", {"what": "calibration", "of": what}, CalibrationError(message))
    limit_days = protocol.safety.calibration_days
    stale = is_out_of_date(created, limit_days, now)
    facts = {"what": "calibration", "of": what, "age_days": round(age_days, 2), "limit_days": limit_days}
    if not stale:
        return Finding("check", facts)
    if accept_stale:
        return Finding("check", {**facts, "accepted_stale": True})
    age = (
        f"{age_days:.0f} days old" if age_days >= 0 else f"from the future ({-age_days:.0f} days; is the clock right?)"
    )
    return Finding(
        "check",
        facts,
        CalibrationError(
            f"the calibration of {what} is {age}, protocol {protocol.name} allows {limit_days:g}; "
            "calibrate again, or go on with --accept-stale (the journal will say so)"
        ),
    )


def judge_room(luminance_cd_m2: float, u_cd_m2: float, protocol: AdaptationProtocol) -> Finding:
    """Return whether a room is dark enough for a protocol: its luminance and twice its uncertainty below the limit.

    Args:
        luminance_cd_m2: Luminance of the dark field in cd·m⁻².
        u_cd_m2: Its standard uncertainty.
    """
    limit = protocol.safety.darkest_room_cd_m2
    facts = {"luminance_cd_m2": luminance_cd_m2, "u_cd_m2": u_cd_m2, "limit_cd_m2": limit}
    reading = with_u(luminance_cd_m2, COVERAGE * u_cd_m2, "cd m-2", k=COVERAGE)
    if luminance_cd_m2 + COVERAGE * u_cd_m2 <= limit:
        return Finding("room", facts)
    if luminance_cd_m2 > limit:
        message = f"the room has {reading}; protocol {protocol.name} needs less than {limit:.2g}: darken it"
    else:
        message = (
            f"the camera reads {reading}: that does not show the room to be darker than the {limit:.2g} that "
            f"protocol {protocol.name} needs; open its aperture, give it more time (time_limit_s of the bench), or "
            "state another safety.darkest_room_cd_m2"
        )
    return Finding("room", facts, MeasurementError(message))


ROOM_U_REL: Final = 0.05  # 5 % decides whether a room is dark, and less takes long


def measured_room(instrument: Instrument, protocol: AdaptationProtocol, white: str) -> Finding:
    """Return whether what a camera sees is dark enough.

    Args:
        white: Spectrum that light in the room is taken to have.

    Raises:
        CalibrationError: If the camera gives no radiance.
        DeviceError: If it fails.
        InputError: If the spectrum is unknown.
    """
    if instrument.calibration is None or not instrument.calibration.absolute:
        raise CalibrationError(
            "the camera has no absolute calibration, so it cannot measure how dark the room is; calibrate it with "
            "`radiometer calibrate`"
        )
    lm_per_w = luminous_efficacy_lm_per_w(spectrum(white), "photopic")
    radiance = instrument.measure(target_u_rel=ROOM_U_REL).radiance
    return judge_room(radiance.value * lm_per_w, radiance.u * lm_per_w, protocol)


def room_by_camera(request: RunRequest) -> Finding:
    """Open a camera, measure the dark field, and close it again; raises as `measured_room` and `open_instrument`."""
    with open_instrument(request.bench, request.camera) as instrument:
        return measured_room(instrument, request.protocol, request.white)
