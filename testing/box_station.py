"""The daemon's station in this process, with a light box on a pseudo-terminal that can be unplugged."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from drivers.light_box.serial_line import SerialLine
from radiometer.daemon.bench_instrument import BenchInstrument, BenchLight
from radiometer.daemon.journal import Journal
from radiometer.daemon.keeper import KeeperTimes
from radiometer.daemon.station import Station
from radiometer.devices.exposure_account import MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics
from simulators.light_box.box import SimulatedLightBox
from simulators.light_box.lines import PtyServer, WiredLightBox
from testing.daemon_process import write_small_bench

OPTICS = {
    "bleach": ChannelOptics(None, 0.0, 60.0, 5.0),
    "spot": ChannelOptics(453.0, 22.0, 1.5, 3.0),
    "spot_red": ChannelOptics(640.0, 18.0, 1.5, 3.0),
    "spot_green": ChannelOptics(505.0, 30.0, 2.0, 3.0),
    "field": ChannelOptics(None, 0.0, 40.0, 36.6),
    "fixation": ChannelOptics(640.0, 18.0, 0.3, 1.0),
}


@contextlib.asynccontextmanager
async def box_station(
    folder: Path, times: KeeperTimes | None = None
) -> AsyncIterator[tuple[Station, PtyServer, SimulatedLightBox]]:
    """Run a station with a small simulated camera and the twin of the light box behind a pseudo-terminal."""
    twin = SimulatedLightBox()
    server = PtyServer(WiredLightBox(twin), link=folder / "box")
    server.start()

    def open_box() -> SerialLightBox:
        return SerialLightBox(
            BoxLink(SerialLine(str(folder / "box"))), ExposureLedger(OPTICS, MemoryStore(time.monotonic, ("TWIN0001",)))
        )

    instrument = BenchInstrument(write_small_bench(folder), uncalibrated=True)
    station = Station(instrument, Journal(folder / "journal.sqlite"), box=BenchLight(open_box), times=times)
    await station.start()
    try:
        yield station, server, twin
    finally:
        await station.stop()
        server.stop()


async def seconds_until(condition: Callable[[], object], deadline_s: float = 30.0) -> float:
    """Return after how many seconds a condition came true. Raises TimeoutError if it never did."""
    begun = time.monotonic()
    async with asyncio.timeout(deadline_s):
        while not condition():
            await asyncio.sleep(0.01)
    return time.monotonic() - begun
