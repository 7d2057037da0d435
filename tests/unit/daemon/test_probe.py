"""The line of the health report that tells whether a daemon runs."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.probe import check_daemon
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.devices import Health


async def _probe(station: Station) -> Any:
    scpi, http = ScpiServer(station), HttpServer(station)
    ports = await scpi.listen_tcp("127.0.0.1", 0), await http.listen("127.0.0.1", 0)
    finding = await asyncio.to_thread(check_daemon, *ports)
    await http.close()
    await scpi.close()
    return finding


async def test_a_running_daemon_is_named(station: Station) -> None:
    """Its identity is shown and all is well."""
    finding = await _probe(station)
    assert (finding.check, finding.health) == ("daemon", Health.OK)
    assert "Fake,F-1,4711" in finding.message


async def test_alarms_of_a_running_daemon_are_shown(station: Station) -> None:
    """A daemon in trouble is a warning that names the alarm."""
    station.alarms.put_up("calibration", "of another camera")
    finding = await _probe(station)
    assert finding.health is Health.WARNING
    assert "calibration" in finding.message


def test_no_daemon_is_a_note_with_the_way_to_start_one() -> None:
    """Not a fault: one can measure without."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    finding = check_daemon(port, port)
    assert finding.health is Health.NOTE
    assert "radiometer serve" in finding.cure
