"""The daemon's watch over its parts: the watchdog is fed while all run, and one that has died ends all."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from radiometer.daemon.service import Service, ServiceOptions
from radiometer.daemon.station import Station
from radiometer.errors import RadiometerError


class Fed:
    """A watchdog that wants to be fed every few milliseconds."""

    watchdog_period_s = 0.005

    def __init__(self) -> None:
        self.times = 0

    def alive(self) -> None:
        self.times += 1


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
