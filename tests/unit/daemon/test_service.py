"""The daemon's watch over its parts: the watchdog is fed while all run, and one that has died ends all."""

from __future__ import annotations

import asyncio
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from radiometer.daemon.journal import Journal
from radiometer.daemon.limits import parse_networks
from radiometer.daemon.service import Service, ServiceOptions
from radiometer.daemon.station import Station
from radiometer.errors import CalibrationError, OutputError, RadiometerError
from testing.patience import within
from tests.unit.daemon.conftest import QUICK, FakeBox, FakeInstrument

Eventually = Callable[..., Awaitable[None]]


class Fed:
    """A watchdog that wants to be fed every few milliseconds."""

    watchdog_period_s = 0.005

    def __init__(self) -> None:
        self.times = 0

    def alive(self) -> None:
        self.times += 1


class Told(Fed):
    """systemd, which keeps what it is told."""

    watchdog_period_s = None  # type: ignore[assignment]

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def ready(self, status: str) -> None:
        self.lines.append(f"ready {status}")

    def reloading(self) -> None:
        self.lines.append("reloading")

    def stopping(self) -> None:
        self.lines.append("stopping")

    def status(self, text: str) -> None:
        self.lines.append(f"status {text}")


def service_of(station: Station, fed: Fed) -> Any:
    return Service(station, ServiceOptions(), notifier=fed)  # type: ignore[arg-type]


async def test_the_watchdog_is_fed_until_the_daemon_is_told_to_end(station: Station) -> None:
    """While every loop runs it is fed again and again, and nothing is raised."""
    fed = Fed()
    service = service_of(station, fed)
    watching = asyncio.create_task(service._watch())
    while fed.times < 3:
        await asyncio.sleep(0.005)
    service._stop.set()
    await watching
    assert fed.times >= 3


async def test_a_camera_that_hangs_lets_the_watchdog_bite(station: Station, monkeypatch: pytest.MonkeyPatch) -> None:
    """A call that has not returned for minutes is not fed away; the loops themselves still run."""
    fed = Fed()
    service = service_of(station, fed)
    monkeypatch.setattr(
        service, "_station", SimpleNamespace(failed_task=lambda: None, camera=SimpleNamespace(stuck_s=1e6))
    )
    watching = asyncio.create_task(service._watch())
    await asyncio.sleep(0.03)
    assert fed.times == 0
    service._stop.set()
    await watching


@pytest.mark.parametrize(("stuck_s", "fed"), [(599.0, True), (600.0, False)])
async def test_a_call_may_take_ten_minutes(
    station: Station, monkeypatch: pytest.MonkeyPatch, stuck_s: float, fed: bool
) -> None:
    """The longest exposures and the longest patience lie below; what takes longer never ends."""
    notifier = Fed()
    service = service_of(station, notifier)
    camera = SimpleNamespace(stuck_s=stuck_s)
    asked: list[float] = []

    def failed_task() -> None:
        asked.append(stuck_s)
        if len(asked) == 3:
            service._stop.set()

    monkeypatch.setattr(service, "_station", SimpleNamespace(failed_task=failed_task, camera=camera))
    await service._watch()
    assert (notifier.times > 0) == fed


async def test_a_loop_that_ended_ends_the_daemon_with_its_error(station: Station) -> None:
    """The error says which part it was; the watchdog is not fed any more."""
    fed = Fed()
    service = service_of(station, fed)

    async def broken() -> None:
        raise ValueError("the journal's disk is gone")

    task = asyncio.create_task(broken())
    await asyncio.wait([task])
    station._tasks.append(task)
    with pytest.raises(RadiometerError, match="ValueError: the journal's disk is gone"):
        await service._watch()
    station._tasks.remove(task)
    assert fed.times == 0


def fresh(tmp_path: Path, **options: Any) -> tuple[Any, FakeInstrument, list[str], Told]:
    """Return a service on fakes that has not begun, and what it announces and tells systemd."""
    instrument, said, told = FakeInstrument(), list[str](), Told()
    station = Station(instrument, Journal(tmp_path / "journal.sqlite"), box=FakeBox(), times=QUICK)
    chosen = ServiceOptions(**{"scpi_port": 0, "http_port": 0, **options})
    return Service(station, chosen, said.append, told), instrument, said, told  # type: ignore[arg-type]


async def asked(path: Path, message: bytes) -> bytes:
    """Return the line that a Unix socket replies."""
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(message + b"\n")
    reply = await reader.readline()
    writer.close()
    return reply


async def test_a_service_listens_reloads_and_ends_as_signals_say(tmp_path: Path, eventually: Eventually) -> None:
    """It says where it listens, is ready, reloads by SIGHUP for better or worse, tells its state, and ends by SIGTERM.

    The socket opens to user and group alone, and one that a killed daemon left behind is no obstacle.
    """
    place = tmp_path / "scpi"
    left = await asyncio.start_unix_server(lambda reader, writer: None, place)
    left.close()
    service, instrument, said, told = fresh(tmp_path, scpi_socket=place)
    running = asyncio.create_task(service.run())
    await eventually(lambda: told.lines or running.done())
    assert told.lines == ["ready ready"]
    port, web = said[0].split()[2].rpartition(":")[2], said[2].rpartition(":")[0]
    assert said[0].endswith("(no authentication: this machine may connect)")
    assert said[1] == f"SCPI on {place}"
    assert said[2].startswith("HTTP on http://127.0.0.1:")
    assert said[2].endswith("(no token: this machine only)")
    assert said[3:] == [f"journal {tmp_path / 'journal.sqlite'}"]
    assert (port, web) != ("", "")
    assert stat.S_IMODE(place.stat().st_mode) == 0o660
    await eventually(lambda: instrument.is_open)
    assert (await asked(place, b"*IDN?")).startswith(b"Fake,F-1,4711,")
    os.kill(os.getpid(), signal.SIGHUP)
    await eventually(lambda: len(said) == 5)
    assert said[4] == "calibration reloaded: calibration.yaml, made 2026-11-20"
    await eventually(lambda: told.lines[-1] == "ready ready")
    assert "reloading" in told.lines

    def broken() -> str:
        raise CalibrationError("calibration.yaml: no scale")

    instrument.reload_calibration = broken  # type: ignore[method-assign]
    os.kill(os.getpid(), signal.SIGHUP)
    await eventually(lambda: len(said) == 6)
    assert said[5] == "calibration not reloaded: calibration.yaml: no scale"
    await eventually(lambda: told.lines[-1].startswith("ready alarm: calibration not reloaded, the old one stays"))
    await eventually(lambda: not service._reloads)  # of one that has ended nothing is kept
    instrument.reload_calibration = lambda: "again"  # type: ignore[method-assign]
    await service._station.reload_calibration()
    service._station.set_every(50.0)
    await eventually(lambda: told.lines[-1] == "status measuring")
    os.kill(os.getpid(), signal.SIGTERM)
    await running
    assert told.lines[-1] == "stopping"
    assert not place.exists()
    assert not instrument.is_open
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
    assert service._housekeeping.cancelled() or service._housekeeping.cancelling()


async def test_who_may_connect_is_announced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks that are let in, that a token is needed, an IPv6 address in brackets, and what else is told whom."""
    service, _, said, _ = fresh(
        tmp_path, scpi_address="192.0.2.7", scpi_allow=parse_networks(["10.0.0.0/8", "192.0.2.0/24"]),
        http_address="::1", token="secret",
    )  # fmt: skip
    begun: list[str] = []
    other = SimpleNamespace(start=lambda: begun.append("mqtt"), target="broker:1883", topic="lab")
    served = SimpleNamespace(start=lambda: begun.append("pva"), names=("a", "b"))

    async def at(address: str, port: int) -> int:
        return 5025 if address == "192.0.2.7" else 8080

    monkeypatch.setattr(service._scpi, "listen_tcp", at)
    monkeypatch.setattr(service._http, "listen", at)
    service._mqtt, service._pva = other, served
    await service._listen()
    assert said[:4] == [
        "SCPI on 192.0.2.7:5025 (no authentication: 10.0.0.0/8, 192.0.2.0/24 may connect)",
        "HTTP on http://[::1]:8080/ (token needed)",
        "MQTT to broker:1883 under lab/",
        "pvAccess: a, b (no authentication; read only)",
    ]
    assert begun == ["mqtt", "pva"]
    nobody, _, quiet, _ = fresh(tmp_path, scpi_address=None, http_address=None)
    await nobody._listen()
    assert len(quiet) == 1


async def test_a_service_that_cannot_listen_ends_with_all_that_it_began(tmp_path: Path) -> None:
    """A taken port is an error that names it; what was started before is stopped, and systemd is told."""
    taken = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
    port = taken.sockets[0].getsockname()[1]
    service, instrument, said, told = fresh(tmp_path, http_address=None, scpi_port=port)
    ended: list[str] = []

    async def stop(name: str) -> None:
        ended.append(name)

    service._mqtt = SimpleNamespace(stop=lambda: stop("mqtt"))
    service._pva = SimpleNamespace(stop=lambda: stop("pva"))
    with pytest.raises(OutputError, match=f"cannot listen for SCPI on 127.0.0.1:{port}: "):
        await service.run()
    assert (said, told.lines) == ([], ["stopping"])
    assert ended == ["pva", "mqtt"]
    assert not instrument.is_open
    taken.close()


async def test_a_socket_s_name_that_is_a_file_is_left_alone(tmp_path: Path) -> None:
    """What is no socket is not removed: the error says that the name is taken."""
    place = tmp_path / "notes"
    place.write_text("keep me")
    service, *_ = fresh(tmp_path, scpi_address=None, http_address=None, scpi_socket=place)
    with pytest.raises(OutputError, match=f"cannot listen for SCPI on {place}: "):
        await service._listen()
    assert place.read_text() == "keep me"


async def test_hearing_from_other_machines_needs_a_list(tmp_path: Path) -> None:
    """An address beyond loopback is refused without one, in words that tell the way out."""
    service, *_ = fresh(tmp_path, scpi_address="0.0.0.0")
    with pytest.raises(RadiometerError, match=r"--scpi-allow \(addresses or networks\), or stay on 127\.0\.0\.1"):
        await service._listen()


@pytest.mark.slow
def test_the_daemon_starts_without_what_it_does_not_need() -> None:
    """scipy.stats takes longer to load than all the daemon's own modules; nothing of the daemon asks for it."""
    words = "import radiometer.daemon.service, radiometer.daemon.bench_instrument, radiometer.daemon.bench_light"
    code = f"import sys; {words}; print(sorted({{'scipy.stats', 'pandas', 'matplotlib', 'numba'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=within(60))
    assert done.stdout == "[]\n"
