"""A fast series of one patch: how a light changes from frame to frame, at equal steps of time."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Final

import numpy as np

from radiometer.acquire.bracketing import own_shutter, take_dark_frames
from radiometer.analysis.flicker import Waveform
from radiometer.data import Frame, Patch
from radiometer.devices import Camera, Roi
from radiometer.errors import DeviceError, MeasurementError

_FILL: Final = 0.7  # of full scale: the brightest moment of a waveform may be missed by a pilot
_PILOTS: Final = 64  # frames that show the brightest moment of light that changes
_DARK_FRAMES: Final = 16  # their mean is known to a quarter of a frame's noise
_UNEVEN: Final = 0.02  # of a step: what a camera's time stamps may scatter by without a frame being lost
_LONGEST_S: Final = 1e-3  # 1.6 % of a modulation at 100 Hz averages out over it


def take_series(camera: Camera, patch: Patch, duration_s: float, exposure_s: float | None = None) -> Waveform:
    """Take frames of a patch as fast as the camera gives them; light is in DN above darkness.

    Only the patch is read out. The exposure is 1 ms or shorter, so that no frame clips. Darkness comes from the
    camera's own shutter, else from its stated black level. Raises MeasurementError if frames clip at the shortest
    exposure, were lost, or the black level is unknown, and DeviceError if the camera fails.
    """
    before = camera.settings
    low, high = camera.capabilities.exposure_s
    camera.configure(replace(before, roi=Roi(patch.x, patch.y, patch.width, patch.height), exposure_s=low))
    try:
        # An exposure as long as the readout of the patch costs no frames.
        readout_s = 1.0 / _rate_hz(list(itertools.islice(camera.stream(), _PILOTS)))
        first = exposure_s or min(_LONGEST_S, readout_s)
        camera.configure(replace(camera.settings, exposure_s=min(max(first, low), high)))
        rate = _unclipped(camera, low, fixed=exposure_s is not None)
        frames = list(itertools.islice(camera.stream(), max(2, math.ceil(duration_s * rate))))
        taken_s = camera.settings.exposure_s
        dark, u_dark, note = _darkness(camera, frames)
    finally:
        camera.configure(before)
    if any(_brightest(frame) >= 1.0 for frame in frames):
        raise MeasurementError("the light clips in some frames; take a shorter --exposure or a smaller aperture")
    light = np.array([float(frame.dn.mean()) for frame in frames]) - dark
    rate = _rate_hz(frames)
    of_rate = f"the camera took {rate:.4g} frames per s: modulation above {rate / 2:.4g} Hz shows at a wrong frequency"
    return Waveform(light, rate, f"camera {camera.identity.serial}", u_dark, taken_s, (note, of_rate))


def _unclipped(camera: Camera, shortest_s: float, *, fixed: bool) -> float:
    """Shorten the exposure until the brightest of some frames is well below full scale; return frames per s."""
    while True:
        pilots = list(itertools.islice(camera.stream(), _PILOTS))
        brightest, exposure_s = max(map(_brightest, pilots)), camera.settings.exposure_s
        if fixed or brightest <= _FILL:
            return _rate_hz(pilots)
        if exposure_s <= shortest_s * (1 + 1e-9):
            raise MeasurementError("the light clips at the shortest exposure; close the aperture or use a grey filter")
        camera.configure(replace(camera.settings, exposure_s=max(shortest_s, exposure_s / 2.0)))


def _brightest(frame: Frame) -> float:
    return float(np.percentile(frame.dn, 99.0)) / frame.saturated_dn


def _rate_hz(frames: list[Frame]) -> float:
    """Return the frames per s. Raises MeasurementError where steps are unequal: frames were lost."""
    known = np.array([frame.settings.timestamp_s for frame in frames if frame.settings.timestamp_s is not None])
    if known.size < len(frames):
        raise MeasurementError("the camera states no times of its frames, so they are no waveform")
    steps = np.diff(known)
    step = float(np.median(steps))
    if step <= 0.0 or np.abs(steps - step).max() > max(_UNEVEN * step, 1e-9):
        at = int(np.argmax(np.abs(steps - step)))
        raise MeasurementError(
            f"frames {at} and {at + 1} are {1e3 * steps[at]:.3g} ms apart, the others {1e3 * step:.3g} ms: frames were "
            "lost; take a smaller patch or a shorter series"
        )
    return (known.size - 1) / float(known[-1] - known[0])


def _darkness(camera: Camera, frames: list[Frame]) -> tuple[float, float, str]:
    """Return the level of darkness in DN, its standard uncertainty, and where it is from."""
    if camera.capabilities.has_shutter:
        shut = own_shutter(camera)
        taken = take_dark_frames(camera, [camera.settings.exposure_s], _DARK_FRAMES, shut)
        values = np.array([float(frame.dn.mean()) for frame in taken])
        return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(values.size), "darkness by the shutter"
    stated = frames[0].settings.black_level_dn
    level = camera.description.black_level_dn if stated is None else stated
    if level is None:
        raise DeviceError("the camera states no black level: give --black-level in DN")
    return float(level), 0.5, f"darkness is the black level of {level:g} DN that the camera states, known to 0.5 DN"
