"""Devices that come and go: the camera on the wire, and the light box on a pseudo-terminal."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from benchmarks import daemon_loss
from benchmarks._daemon import DaemonProcess, write_small_bench
from drivers.light_box import SerialLightBox
from drivers.light_box_link import BoxLink
from drivers.serial_line import SerialLine
from radiometer.daemon.bench_instrument import BenchInstrument
from radiometer.daemon.bench_light import BenchLight
from radiometer.daemon.journal import Journal
from radiometer.daemon.station import Station
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import DeviceError, SettingOutOfRange
from simulators.light_box import LightBoxTwin
from simulators.pty_line import PtyServer, WiredTwin

OPTICS = {
    "bleach": ChannelOptics(None, 0.0, 60.0, 5.0),
    "spot": ChannelOptics(453.0, 22.0, 1.5, 3.0),
    "spot_red": ChannelOptics(640.0, 18.0, 1.5, 3.0),
    "fixation": ChannelOptics(640.0, 18.0, 0.3, 1.0),
}


@pytest.mark.timeout(170)
def test_a_camera_on_the_wire_is_lost_and_found() -> None:
    """Two cycles here, twenty in the benchmark: clients are told within 2 s, readings are back within 5 s.

    Twice as long where other work fills the machine.
    """
    slack = 2 if os.getloadavg()[0] > (os.cpu_count() or 1) else 1
    pytest.importorskip("gi")
    try:
        result = daemon_loss.run(2)
    except RuntimeError as taken:
        pytest.skip(f"another camera is served on this machine: {taken}"[:200])
    assert max(result.told_s) < 2.0 * slack
    assert max(result.recovered_s) < 5.0 * slack


@contextlib.asynccontextmanager
async def _with_box(folder: Path) -> AsyncIterator[tuple[Station, PtyServer, LightBoxTwin]]:
    twin = LightBoxTwin()
    server = PtyServer(WiredTwin(twin), link=folder / "box")
    server.start()

    def open_box() -> SerialLightBox:
        return SerialLightBox(BoxLink(SerialLine(str(folder / "box"))), ExposureLedger(OPTICS, time.monotonic))

    instrument = BenchInstrument(write_small_bench(folder), uncalibrated=True)
    station = Station(instrument, Journal(folder / "journal.sqlite"), box=BenchLight(open_box))
    await station.start()
    try:
        yield station, server, twin
    finally:
        await station.stop()
        server.stop()


async def _seconds_until(condition: Callable[[], object], deadline_s: float = 10.0) -> float:
    begun = time.monotonic()
    async with asyncio.timeout(deadline_s):
        while not condition():
            await asyncio.sleep(0.01)
    return time.monotonic() - begun


async def test_the_light_box_is_set_through_its_driver(tmp_path: Path) -> None:
    """A level reaches the LED; above the channel's range it is refused; stopping leaves the box dark."""
    async with _with_box(tmp_path) as (station, _, twin):
        assert set(station.levels) == set(OPTICS)
        level = await station.set_level("spot", 0.25)
        assert level == pytest.approx(0.25, abs=1e-4)
        await _seconds_until(lambda: abs(twin.duty("spot") - 0.25) < 0.01)
        with pytest.raises(SettingOutOfRange):
            await station.set_level("spot", 1.5)
    assert twin.duty("spot") == 0.0


@pytest.mark.timeout(170)
async def test_a_light_box_is_unplugged_and_replugged_twenty_times(tmp_path: Path) -> None:
    """Each loss is told within 2 s, each return within 5 s, and the levels are known to be dark then."""
    async with _with_box(tmp_path) as (station, server, _):
        for _ in range(20):
            await station.set_level("fixation", 0.1)
            server.unplug()
            told_s = await _seconds_until(lambda: [alarm.name for alarm in station.alarms.active] == ["light box"])
            with pytest.raises(DeviceError):
                await station.set_level("fixation", 0.2)
            server.plug()
            recovered_s = await _seconds_until(lambda: not station.alarms.active)
            assert told_s < 2.0
            assert recovered_s < 5.0
            assert set(station.levels.values()) == {0.0}
        assert station.box_keeper is not None
        assert station.box_keeper.losses == 20


def test_serve_drives_the_simulated_box(tmp_path: Path) -> None:
    """`--box sim`: channels by name and number, levels read back, dark on request."""
    with DaemonProcess(tmp_path, "--box", "sim") as daemon:
        assert daemon.ask("SOUR:LED:CAT?") == '"bleach","spot","spot_red","fixation"'
        assert float(daemon.ask("SOUR:LED2:LEV 0.01;LEV?")) == pytest.approx(0.01, abs=1e-4)
        assert daemon.get("/status")["light"]["spot"] == pytest.approx(0.01, abs=1e-4)
        assert daemon.post("/light", {"channel": "spot", "level": 0})["level"] == 0
        assert daemon.ask("SOUR:LED9:LEV?\nSYST:ERR?").startswith("-114")
