"""Checks that any camera can undergo: frame rate, temperature, dark level, linearity."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass, replace

import numpy as np

from radiometer.data import Frame
from radiometer.data.sensor_noise import SensorNoise
from radiometer.devices import Camera, CameraSettings, Finding, Health

_RATE_FRAMES, _RATE_LIMIT_S = 30, 5.0
_HOT_C = 65.0  # dark current has grown a hundredfold over 20 °C there, and makers' limits are near
_METER_STEPS = 12  # by 0.1 to 16 times each: 12 cross the range of any camera
_LONGEST_CHECK_S = 1.0  # a check is not worth more of a person's time
_LINEAR_WITHIN = 0.005  # beyond the noise: what a linear sensor and its exposure clock keep easily
_LIGHT = (0.35, 0.75)  # of full scale: where the brighter of two exposures is put


def check_camera(camera: Camera) -> list[Finding]:
    """Return what was found of an open camera; its settings are changed. Raises DeviceError if it fails."""
    dark, black_dn = check_dark_level(camera)
    return [check_frame_rate(camera), check_temperature(camera), dark, check_linearity(camera, black_dn)]


def check_frame_rate(camera: Camera) -> Finding:
    """Return the frame rate achieved at full size, and what was lost on the way."""
    camera.configure(replace(camera.settings, exposure_s=max(1e-3, camera.capabilities.exposure_s[0]), roi=None))
    before = camera.counts
    frames, start = 0, time.monotonic()
    stream = camera.stream()
    for _ in itertools.islice(stream, _RATE_FRAMES):
        frames += 1
        if time.monotonic() - start > _RATE_LIMIT_S:
            break
    elapsed_s = time.monotonic() - start
    stream.close()
    after = camera.counts
    lost = after.incomplete - before.incomplete
    missed = after.extra.get("missed_frames", 0) - before.extra.get("missed_frames", 0)
    message = f"{frames / elapsed_s:.1f} frames/s at full size; {lost} incomplete, {missed} missed of {frames}"
    if lost or missed:
        cure = "see socket buffers, MTU and cable; lost frames are taken again, but brackets take longer"
        return Finding("frame rate", Health.WARNING, message, cure)
    return Finding("frame rate", Health.OK, message)


def check_temperature(camera: Camera) -> Finding:
    """Return the sensor temperature."""
    frame = camera.capture(1)[0]
    temperature_c = frame.settings.temperature_c
    if temperature_c is None:
        return Finding(
            "temperature", Health.NOTE, "the camera reports none", "let it warm up for 30 min before calibrating"
        )
    if temperature_c > _HOT_C:
        return Finding("temperature", Health.WARNING, f"{temperature_c:.1f} °C", "give it a heat sink or moving air")
    return Finding("temperature", Health.OK, f"{temperature_c:.1f} °C")


def check_dark_level(camera: Camera) -> tuple[Finding, float]:
    """Return what was found of the black level, and the level in DN to take off."""
    shortest = camera.capabilities.exposure_s[0]
    settings = camera.configure(replace(camera.settings, exposure_s=shortest))
    shutter = camera.capabilities.has_shutter
    if shutter:
        camera.set_shutter(closed=True)
    first, second = camera.capture(2)
    if shutter:
        camera.set_shutter(closed=False)
    mean, noise = _level_and_noise(first, second)
    at_zero = float(np.mean(first.dn == 0))
    how = "shutter closed" if shutter else f"at {shortest:g} s, not covered"
    message = f"{mean:.2f} DN ({how}; {settings.black_level_dn:g} DN set), noise {noise:.2f} DN, {at_zero:.2%} at zero"
    if at_zero > 1e-3:
        cure = "raise the black level until nothing is cut off at zero; a cut-off dark signal cannot be subtracted"
        return Finding("dark level", Health.WARNING, message, cure), mean
    if not shutter:
        cure = "cover the lens and run it again for the true dark level"
        return Finding("dark level", Health.OK, message, cure), settings.black_level_dn
    return Finding("dark level", Health.OK, message), mean


def check_linearity(camera: Camera, black_dn: float) -> Finding:
    """Return whether half the exposure gives half the signal in the well-exposed pixels.

    Args:
        black_dn: Dark level in DN.
    """
    settings = _metered(camera, black_dn)
    if settings is None:
        cure = "point the camera at an even, steady light and run it again"
        return Finding("linearity", Health.NOTE, "too little or too much light for the check", cure)
    ratio = _halving_ratio(camera, settings, black_dn)
    message = f"half of {settings.exposure_s:.4g} s gives {ratio.value:.5f} ± {ratio.u:.5f} (k = 1) of the signal"
    if abs(ratio.value - 0.5) <= 0.5 * _LINEAR_WITHIN + 5 * ratio.u:
        return Finding("linearity", Health.OK, message)
    cure = "is the light steady (flicker), and gamma off? Recover the response with `radiometer response`"
    return Finding("linearity", Health.WARNING, f"{message}, not 0.5", cure)


@dataclass(frozen=True, slots=True)
class _Ratio:
    value: float
    u: float


def _halving_ratio(camera: Camera, settings: CameraSettings, black_dn: float) -> _Ratio:
    longer_s = camera.configure(settings).exposure_s
    longer = camera.capture(4)
    shorter_s = camera.configure(replace(settings, exposure_s=settings.exposure_s / 2)).exposure_s
    shorter = camera.capture(4)
    lit = longer[0].dn > black_dn + 0.5 * (_high(longer[0]) - black_dn)
    lit &= longer[0].dn < 0.9 * longer[0].saturated_dn
    bright, dim = (np.array([f.dn[lit].mean() for f in group]) - black_dn for group in (longer[1:], shorter[1:]))
    value = float(dim.mean() / bright.mean()) * (longer_s / shorter_s) / 2
    noise = SensorNoise.of(camera.description)
    signal = np.array([bright.mean(), dim.mean()])
    variance = noise.variance_dn2(signal, settings.gain_db) / (3 * max(int(lit.sum()), 1))
    scatter = np.array([bright.var(ddof=1), dim.var(ddof=1)]) / 3
    u_rel = math.sqrt(float(np.sum(np.maximum(variance, scatter) / signal**2)))
    return _Ratio(value, value * u_rel)


def _metered(camera: Camera, black_dn: float) -> CameraSettings | None:
    """Return settings under which the brightest pixels are between a third and three quarters of full scale."""
    low_s, high_s = camera.capabilities.exposure_s
    settings = replace(camera.settings, exposure_s=min(max(0.01, 2 * low_s), high_s))
    for _ in range(_METER_STEPS):
        frame = camera.capture(1)[0] if camera.configure(settings) else None
        if frame is None:
            return None
        fraction = (_high(frame) - black_dn) / (frame.saturated_dn - black_dn)
        if _LIGHT[0] <= fraction <= _LIGHT[1]:
            return settings
        factor = 0.25 if fraction > 0.95 else min(max(0.55 / max(fraction, 1e-4), 0.1), 16.0)
        exposure_s = settings.exposure_s * factor
        if not 2 * low_s <= exposure_s <= min(high_s, _LONGEST_CHECK_S):
            return None
        settings = replace(settings, exposure_s=exposure_s)
    return None


def _high(frame: Frame) -> float:
    return float(np.percentile(frame.dn, 95))


def _level_and_noise(first: Frame, second: Frame) -> tuple[float, float]:
    difference = first.dn.astype(np.float64) - second.dn
    mean = 0.5 * (float(first.dn.mean()) + float(second.dn.mean()))
    return mean, float(difference.std()) / math.sqrt(2)
