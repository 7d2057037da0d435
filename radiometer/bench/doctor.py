"""Examines the whole chain from library to light, and says how to cure what is wrong."""

from __future__ import annotations

from pathlib import Path

from radiometer.bench.camera_health import check_camera
from radiometer.bench.cameras import open_camera
from radiometer.bench.config import read_bench
from radiometer.data.serials import serial_shown
from radiometer.devices import Camera, Finding, Health
from radiometer.errors import DeviceError, RadiometerError


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
