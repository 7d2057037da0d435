"""Looks whether a daemon runs on this machine: one line of the health report."""

from __future__ import annotations

import http.client
import socket
from typing import Final

from radiometer.data.json_text import parsed_json
from radiometer.devices import Finding, Health

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
