"""The dark room of the adaptation test, measured by a camera."""

from __future__ import annotations

from typing import Final

from radiometer.adaptation.checks import Finding, judge_room
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.request import RunRequest
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.bench.assembly import open_instrument
from radiometer.bench.instrument import Instrument
from radiometer.errors import CalibrationError

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
