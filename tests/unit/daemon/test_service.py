"""The daemon's watch over its parts: the watchdog is fed while all run, and one that has died ends all."""

from __future__ import annotations

import asyncio
import os
import re
import resource
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.descriptors import Descriptors, listen
from radiometer.daemon.epics import PvaOptions
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_reader import JournalReader
from radiometer.daemon.limits import parse_networks
from radiometer.daemon.service import Service, ServiceOptions
from radiometer.daemon.station import Station
from radiometer.errors import CalibrationError, OutputError, RadiometerError
from testing.fake_station import QUICK, FakeBox, FakeInstrument
from testing.patience import within

Eventually = Callable[..., Awaitable[None]]


class Told:
    """systemd, which wants to hear every few milliseconds that the daemon lives, and keeps what it receives."""

    watchdog_period_s = 0.005

    def __init__(self) -> None:
        self.fed, self.lines = 0, list[str]()

    def alive(self) -> None:
        self.fed += 1

    def ready(self, status: str) -> None:
        self.lines.append(f"ready {status}")

    def reloading(self) -> None:
        self.lines.append("reloading")

    def stopping(self) -> None:
        self.lines.append("stopping")

    def status(self, text: str) -> None:
        self.lines.append(f"status {text}")


@dataclass
class Daemon:
    """A service on fakes that has not begun, what it announces, and what it sends to systemd."""

    service: Service
    station: Station
    instrument: FakeInstrument
    announced: list[str]
    systemd: Told


def fresh(tmp_path: Path, **options: Any) -> Daemon:
    """Return a service on free ports, with other options as given."""
    instrument, announced, systemd = FakeInstrument(), list[str](), Told()
    station = Station(instrument, Journal(tmp_path / "journal.sqlite"), box=FakeBox(), times=QUICK)
    chosen = ServiceOptions(**{"scpi_port": 0, "http_port": 0, **options})
    return Daemon(Service(station, chosen, announced.append, systemd), station, instrument, announced, systemd)  # type: ignore[arg-type]


async def ended(running: asyncio.Task[None]) -> None:
    """End a daemon as systemd does."""
    os.kill(os.getpid(), signal.SIGTERM)
    await running


@pytest.mark.parametrize(("stuck_s", "fed"), [(0.0, True), (599.0, True), (600.0, False)])
async def test_the_watchdog_is_fed_unless_a_call_takes_ten_minutes(tmp_path, monkeypatch, eventually, stuck_s, fed):
    """The longest exposures and the longest patience are below; a call that takes longer never ends."""
    one = fresh(tmp_path)
    monkeypatch.setattr(type(one.station.camera), "stuck_s", stuck_s)
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines)
    if fed:
        await eventually(lambda: one.systemd.fed >= 3)
    else:
        await asyncio.sleep(0.03)
        assert one.systemd.fed == 0
    await ended(running)


async def test_an_alarm_of_descriptors_ends_once_some_are_free(tmp_path, eventually):
    """The running daemon looks for itself: no client has to come first."""
    one = fresh(tmp_path)
    one.station.alarms.put_up("descriptors", "no file descriptor is free")
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines and not one.station.alarms.active)
    await ended(running)


async def test_a_loop_that_ended_ends_the_daemon_with_its_error(tmp_path, monkeypatch):
    """The error names its kind and reason; the watchdog is not fed any more, and the camera is closed."""
    one = fresh(tmp_path)
    monkeypatch.setattr(one.station, "failed_task", lambda: ValueError("the journal's disk is gone"))
    with pytest.raises(RadiometerError, match="ValueError: the journal's disk is gone"):
        await one.service.run()
    assert one.systemd.fed == 0
    assert one.systemd.lines[-1] == "stopping"
    assert not one.instrument.is_open


async def test_start_and_stop_are_events_of_the_journal(tmp_path, monkeypatch, eventually):
    """A signal is named, and so is the error that ends a daemon; what happens between them is between them."""
    one = fresh(tmp_path)
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines)
    one.station.annotate("lamp changed")
    await ended(running)
    other = fresh(tmp_path)
    monkeypatch.setattr(other.station, "failed_task", lambda: ValueError("the journal's disk is gone"))
    with pytest.raises(RadiometerError, match="ValueError"):
        await other.service.run()
    events = [event for event in JournalReader(tmp_path / "journal.sqlite").events() if event["kind"] != "light"]
    assert [event["kind"] for event in events] == ["start", "remark", "stop", "start", "stop"]
    assert [events[number]["message"] for number in (2, 4)] == [
        "ended by SIGTERM", "the daemon ends: ValueError: the journal's disk is gone",
    ]  # fmt: skip


async def asked(path: Path, message: bytes) -> bytes:
    """Return the line that a Unix socket replies."""
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(message + b"\n")
    reply = await reader.readline()
    writer.close()
    return reply


async def test_a_service_listens_reloads_and_ends_as_signals_say(tmp_path, eventually):
    """It says where it listens, is ready, reloads by SIGHUP for better or worse, shows its state, and ends by SIGTERM.

    The socket opens to user and group alone, and one that a killed daemon left behind is no obstacle.
    """
    place = tmp_path / "scpi"
    left = await asyncio.start_unix_server(lambda reader, writer: None, place)
    left.close()
    one = fresh(tmp_path, scpi_socket=place)
    instrument, announced, systemd = one.instrument, one.announced, one.systemd
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: systemd.lines or running.done())
    assert systemd.lines == ["ready ready"]
    port, web = announced[0].split()[2].rpartition(":")[2], announced[2].rpartition(":")[0]
    assert announced[0].endswith("(no authentication: this machine may connect)")
    assert announced[1] == f"SCPI on {place}"
    assert announced[2].startswith("HTTP on http://127.0.0.1:")
    assert announced[2].endswith("(no token: this machine only)")
    assert announced[3:] == [f"journal {tmp_path / 'journal.sqlite'}"]
    assert (port, web) != ("", "")
    assert stat.S_IMODE(place.stat().st_mode) == 0o660
    await eventually(lambda: instrument.is_open)
    assert (await asked(place, b"*IDN?")).startswith(b"Fake,F-1,4711,")
    os.kill(os.getpid(), signal.SIGHUP)
    await eventually(lambda: len(announced) == 5)
    assert announced[4] == "calibration reloaded: calibration.yaml, made 2026-11-20"
    await eventually(lambda: systemd.lines[-1] == "ready ready")
    assert "reloading" in systemd.lines

    def broken() -> str:
        raise CalibrationError("calibration.yaml: no scale")

    instrument.reload_calibration = broken  # type: ignore[method-assign]
    os.kill(os.getpid(), signal.SIGHUP)
    await eventually(lambda: len(announced) == 6)
    assert announced[5] == "calibration not reloaded: calibration.yaml: no scale"
    await eventually(lambda: systemd.lines[-1].startswith("ready alarm: calibration not reloaded, the old one stays"))
    instrument.reload_calibration = lambda: "again"  # type: ignore[method-assign]
    await one.station.reload_calibration()
    one.station.set_every(50.0)
    await eventually(lambda: systemd.lines[-1] == "status measuring")
    await ended(running)
    assert systemd.lines[-1] == "stopping"
    assert not place.exists()
    assert not instrument.is_open
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL


async def test_a_storm_of_hangups_is_one_reload_and_one_more(tmp_path, eventually):
    """Each reload stops the camera: 100 signals within a moment stop it twice, for the last one must count."""
    one = fresh(tmp_path)
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines or running.done())
    for _ in range(100):
        os.kill(os.getpid(), signal.SIGHUP)
        await asyncio.sleep(0.001)
    await eventually(lambda: one.instrument.reloads == 2)
    await asyncio.sleep(0.05)
    assert one.instrument.reloads == 2
    await ended(running)


async def test_who_may_connect_is_announced(tmp_path, eventually):
    """Networks that are let in, that a token is needed, and how pvAccess is served."""
    options = {"scpi_address": "0.0.0.0", "scpi_allow": parse_networks(["10.0.0.0/8", "192.0.2.0/24"])}
    one = fresh(tmp_path, **options, token="a-secret-of-sixteen", pva=PvaOptions("lab", isolated=True))
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines or running.done())
    scpi, web, pva, journal = one.announced
    assert re.fullmatch(
        r"SCPI on 0\.0\.0\.0:\d+ \(no authentication: 10\.0\.0\.0/8, 192\.0\.2\.0/24 may connect\)", scpi
    )
    assert re.fullmatch(r"HTTP on http://127\.0\.0\.1:\d+/ \(token needed\)", web)
    assert pva.startswith("pvAccess: ")
    assert pva.endswith("(no authentication; read only)")
    assert journal == f"journal {tmp_path / 'journal.sqlite'}"
    await ended(running)


async def test_a_service_that_listens_nowhere_only_keeps_its_journal(tmp_path, eventually):
    """No port is opened that was not asked for."""
    one = fresh(tmp_path, scpi_address=None, http_address=None)
    running = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines)
    assert one.announced == [f"journal {tmp_path / 'journal.sqlite'}"]
    await ended(running)


async def test_a_service_that_cannot_listen_ends_with_all_that_it_began(tmp_path):
    """A taken port is an error that names it; what was started before is stopped, and systemd is notified."""
    taken = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
    port = taken.sockets[0].getsockname()[1]
    one = fresh(tmp_path, http_address=None, scpi_port=port)
    with pytest.raises(OutputError, match=f"cannot listen for SCPI on 127.0.0.1:{port}: "):
        await one.service.run()
    assert (one.announced, one.systemd.lines) == ([], ["stopping"])
    assert not one.instrument.is_open
    taken.close()


async def test_hearing_from_other_machines_needs_a_list(tmp_path):
    """An address beyond loopback is refused without one, in words that tell the way out."""
    with pytest.raises(RadiometerError, match=r"--scpi-allow \(addresses or networks\), or stay on 127\.0\.0\.1"):
        await fresh(tmp_path, scpi_address="0.0.0.0").service.run()


@pytest.mark.slow
def test_the_daemon_starts_without_what_it_does_not_need():
    """scipy.stats takes longer to load than all the daemon's own modules; nothing of the daemon asks for it."""
    words = "import radiometer.daemon.service, radiometer.daemon.bench_instrument, radiometer.daemon.bench_instrument"
    code = f"import sys; {words}; print(sorted({{'scipy.stats', 'pandas', 'matplotlib', 'numba'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=within(60))
    assert done.stdout == "[]\n"


async def test_no_descriptors_are_one_alarm_and_a_few_tries_a_second():
    """Fifty clients knock while none can be taken: nothing floods, and all are served afterwards."""
    changes: list[str] = []
    descriptors = Descriptors(Alarms(lambda kind, name, message: changes.append(f"{kind} {name}")))
    loop, tries, served = asyncio.get_running_loop(), 0, 0

    def take(failed: asyncio.AbstractEventLoop, context: dict[str, object]) -> None:
        nonlocal tries
        tries += 1
        descriptors.take_error(failed, context)

    class Client(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            nonlocal served
            served += 1

    loop.set_exception_handler(take)
    server = await listen(Client, "127.0.0.1", 0)
    address = server.sockets[0].getsockname()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as clients:
        try:
            waiting = [clients.enter_context(socket.socket()) for _ in range(50)]
            for one in waiting:
                one.setblocking(False)
                one.connect_ex(address)
            lowest_free = os.dup(0)
            os.close(lowest_free)
            resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, limits[1]))
            await asyncio.sleep(2.5)
            assert 1 <= tries <= 10
            descriptors.look()
            assert changes == ["alarm descriptors"]
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        async with asyncio.timeout(20):
            while served < 50:
                await asyncio.sleep(0.05)
        descriptors.look()
        assert changes == ["alarm descriptors", "cleared descriptors"]
    server.close()
