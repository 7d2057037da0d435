"""The line of the health report that shows whether a daemon runs."""

import asyncio
import socket
import threading

import pytest

from radiometer.bench.doctor import check_daemon
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.devices import Health


async def _probe(station):
    scpi, http = ScpiServer(station), HttpServer(station)
    ports = await scpi.listen_tcp("127.0.0.1", 0), await http.listen("127.0.0.1", 0)
    finding = await asyncio.to_thread(check_daemon, *ports)
    await http.close()
    await scpi.close()
    return finding


async def test_a_running_daemon_is_named(station):
    """Its identity is shown and all is well."""
    finding = await _probe(station)
    assert (finding.check, finding.health) == ("daemon", Health.OK)
    assert "Fake,F-1,4711" in finding.message


async def test_alarms_of_a_running_daemon_are_shown(station):
    """A daemon in trouble is a warning that names the alarm."""
    station.alarms.put_up("calibration", "of another camera")
    finding = await _probe(station)
    assert finding.health is Health.WARNING
    assert "calibration" in finding.message


def test_no_daemon_is_a_note_with_the_way_to_start_one():
    """Not a fault: one can measure without."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    finding = check_daemon(port, port)
    assert finding.health is Health.NOTE
    assert "radiometer serve" in finding.cure


@pytest.mark.parametrize("reply", [b"Keysight,34465A,MY1,A.02\n", b""])
def test_a_stranger_on_the_port_is_named(reply):
    """Another program there, or one that says nothing, is a warning with what it stated and the way round."""
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        port = int(stranger.getsockname()[1])

        def answer():
            line, _ = stranger.accept()
            with line:
                assert line.recv(100) == b"*IDN?\n"
                line.sendall(reply)

        thread = threading.Thread(target=answer)
        thread.start()
        finding = check_daemon(port, port)
        thread.join()
    assert finding.health is Health.WARNING
    assert finding.message.endswith(f"another program: {reply.decode().strip()}")
    assert "--scpi-port" in finding.cure


@pytest.mark.slow  # waits in real time
def test_one_that_says_nothing_is_not_waited_for_long():
    """A program that takes the call and is silent is a stranger, not no one."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = int(silent.getsockname()[1])
        assert check_daemon(port, port).health is Health.WARNING
