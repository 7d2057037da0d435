"""Examines the whole chain from library to light, daemon and camera included, and says how to cure what is wrong."""

from __future__ import annotations

import http.client
import itertools
import math
import socket
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.bench.cameras import open_camera
from radiometer.bench.config import read_bench
from radiometer.data import Frame
from radiometer.data.capture_header import serial_shown
from radiometer.data.json_text import parsed_json
from radiometer.data.sensor_noise import SensorNoise
from radiometer.devices import Camera, CameraSettings, Finding, Health
from radiometer.errors import DeviceError, RadiometerError

SCPI_PORT: Final = 5025  # the daemon's default, registered for SCPI (IANA: scpi-raw)
HTTP_PORT: Final = 8080  # the daemon's default
_CHECK: Final = "daemon"
_PATIENCE_S: Final = 1.0  # a daemon on this computer answers within ms
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


def check_daemon(scpi_port: int = SCPI_PORT, http_port: int = HTTP_PORT) -> Finding:
    """Return whether a daemon answers on loopback, and its alarms."""
    identity = _identity(scpi_port)
    if identity is None:
        cure = "`radiometer serve` starts it; configs/systemd/radiometer.service keeps it running"
        return Finding(_CHECK, Health.NOTE, f"none answers at 127.0.0.1:{scpi_port}", cure)
    if "radiometer" not in identity:
        cure = "end that program, or give the daemon another port: radiometer serve --scpi-port"
        return Finding(_CHECK, Health.WARNING, f"127.0.0.1:{scpi_port} is taken by another program: {identity}", cure)
    alarms = _alarms(http_port)
    if alarms:
        cure = "`radiometer log --events` shows since when, GET /status shows why"
        return Finding(_CHECK, Health.WARNING, f"{identity} runs with alarms: {', '.join(alarms)}", cure)
    return Finding(_CHECK, Health.OK, f"{identity} answers at 127.0.0.1:{scpi_port}")


def _identity(port: int) -> str | None:
    """Return the reply to *IDN?; None if nothing listens, "" if nothing answers."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=_PATIENCE_S) as line:
            line.sendall(b"*IDN?\n")
            return line.recv(200).decode("ascii", "replace").strip()
    except TimeoutError:
        return ""
    except OSError:
        return None


def _alarms(port: int) -> list[str]:
    """Return the names of the alarms; empty where HTTP is off or elsewhere."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_PATIENCE_S)
    try:
        connection.request("GET", "/healthz")
        return [str(name) for name in parsed_json(connection.getresponse().read(10_000))["alarms"]]
    except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
        return []
    finally:
        connection.close()


def examine(bench: Path | None = None, name: str | None = None) -> list[Finding]:
    """Return what was found of this computer and, where one is named, of a camera.

    Args:
        bench: Bench file; the simulated bench where None.
        name: "sim", or a GenICam id, serial number or address; None to look at the computer alone.

    Raises:
        ConfigurationError: If the bench file is wrong.
    """
    from drivers.cameras.aravis_camera import load_library
    from drivers.cameras.host_checks import check_host
    from drivers.cameras.own_cameras import check_libraries

    findings = [*check_host(load_library), *check_libraries()]
    if name is None:
        return findings
    config, where = read_bench(bench, name)
    try:
        camera = open_camera(config, where, name)
    except DeviceError as error:
        return [*findings, Finding("camera", Health.FAULT, str(error), "`radiometer devices` lists what answers")]
    with_camera = _examined(camera)
    return [*findings, *with_camera]


def _examined(camera: Camera) -> list[Finding]:
    who = camera.identity
    named = f"{who.vendor} {who.model}, serial {serial_shown(who.serial)}, firmware {who.firmware or 'unknown'}"
    findings = [Finding("camera", Health.OK, named)]
    try:
        findings += _features(camera)
        findings += check_camera(camera)
    except RadiometerError as error:
        findings.append(Finding("camera", Health.FAULT, str(error), "cure the faults above first, then run it again"))
    finally:
        camera.close()
    return findings


def _features(camera: Camera) -> list[Finding]:
    from drivers.cameras.aravis_camera import AravisCamera
    from drivers.cameras.camera_checks import check_features
    from drivers.cameras.plain_camera import PlainCamera

    if isinstance(camera, PlainCamera):
        return camera.findings()
    return check_features(camera) if isinstance(camera, AravisCamera) else []
