"""Examines the whole chain from library to light, the daemon included, and says how to cure what is wrong."""

from __future__ import annotations

import http.client
import socket
from pathlib import Path
from typing import Final

from radiometer.bench.camera_health import check_camera
from radiometer.bench.cameras import open_camera
from radiometer.bench.config import read_bench
from radiometer.data.json_text import parsed_json
from radiometer.data.serials import serial_shown
from radiometer.devices import Camera, Finding, Health
from radiometer.errors import DeviceError, RadiometerError

SCPI_PORT: Final = 5025  # the daemon's default, registered for SCPI (IANA: scpi-raw)
HTTP_PORT: Final = 8080  # the daemon's default
_CHECK: Final = "daemon"
_PATIENCE_S: Final = 1.0  # a daemon on this computer answers within ms


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
