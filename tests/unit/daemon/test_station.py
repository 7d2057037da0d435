"""The core measures, commits before it shows, and survives the loss of devices and journal."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.keeper import DeviceState
from radiometer.daemon.state import identity_mapping
from radiometer.daemon.station import Station
from radiometer.data import Patch
from radiometer.devices import CameraIdentity
from radiometer.errors import (
    DeviceError,
    DeviceLost,
    DeviceTimeout,
    MeasurementError,
    RadiometerError,
    SettingOutOfRange,
    UsageError,
)
from testing.patience import within

Eventually = Callable[..., Awaitable[None]]


async def test_a_reading_is_in_the_journal_when_it_is_seen(station: Station) -> None:
    """What `measure` returns can be read from the file at that moment."""
    reading = await station.acquisition.measure()
    assert JournalReader(station.journal_path).lines(ReadingFilter()) == [reading.to_json()]
    assert station.shown.latest == reading


async def test_continuous_measurement_keeps_its_period(station: Station, eventually: Eventually) -> None:
    """One reading at once and one a period: never more, however long the machine lets it wait."""
    begun = time.monotonic()
    station.set_every(0.05)
    await eventually(lambda: station.shown.latest is not None and station.shown.latest.sequence >= 10)
    assert time.monotonic() - begun > 8.5 * 0.05


async def test_on_demand_goes_before_continuous(station: Station, instrument: Any) -> None:
    """A request is served although measuring runs as fast as it goes."""
    station.set_every(0.0)
    reading = await station.acquisition.measure(station.configure(patch=Patch(1, 2, 3, 4)), 20.0)
    assert reading.patch == Patch(1, 2, 3, 4)


async def test_requests_for_the_same_settings_share_a_measurement(station: Station, instrument: Any) -> None:
    """Fifty clients that ask at once cost at most two measurements."""
    readings = await asyncio.gather(*(station.acquisition.measure() for _ in range(50)))
    assert len({reading.sequence for reading in readings}) <= 2
    assert len(instrument.measured) <= 2


async def test_settings_out_of_range_are_refused_and_change_nothing(station: Station) -> None:
    """The error names value, limits and unit; the old settings stay."""
    before = station.settings
    with pytest.raises(SettingOutOfRange, match="1e-05 to 30 s"):
        station.configure(exposure_s=100.0, auto_exposure=False)
    with pytest.raises(UsageError, match="64 × 48"):
        station.configure(patch=Patch(60, 0, 10, 10))
    assert station.settings == before


async def test_a_lost_camera_is_reported_and_reopened(
    station: Station, instrument: Any, eventually: Eventually
) -> None:
    """Loss puts the alarm up and fails requests at once; the return clears it, and measuring goes on."""
    station.set_every(0.01)
    await eventually(lambda: station.shown.latest)
    instrument.unplugged = True
    await eventually(lambda: station.camera.state is DeviceState.LOST)
    assert [alarm.name for alarm in station.alarms.active] == ["camera"]
    with pytest.raises(DeviceError, match="unplugged"):
        await station.acquisition.measure()
    instrument.unplugged = False
    await eventually(lambda: not station.alarms.active)
    assert station.shown.latest is not None
    last = station.shown.latest.sequence
    await eventually(lambda: station.shown.latest is not None and station.shown.latest.sequence > last)
    assert station.camera.losses == 1


async def test_a_camera_that_does_not_return_is_reported_before_it_gives_up(
    station: Station, instrument: Any, eventually: Eventually
) -> None:
    """While a call hangs the alarm is up; once answers come in time again it goes, and no loss is counted."""
    instrument.let_go, instrument.late_at = threading.Event(), time.monotonic() + 0.2
    measuring = asyncio.create_task(station.acquisition.measure())
    await eventually(lambda: station.camera.state is DeviceState.OVERDUE)
    assert "has not answered" in station.alarms.active[0].message
    instrument.let_go.set()
    await measuring
    instrument.late_at = None
    await eventually(lambda: station.alarms.active == ())
    assert station.camera.losses == 0


async def test_a_late_camera_that_turns_out_lost_is_announced_again(
    station: Station, instrument: Any, eventually: Eventually
) -> None:
    """Listeners hear of the delay, then of the loss, as two events."""
    instrument.let_go, instrument.late_at = threading.Event(), time.monotonic() + 0.1
    listener = station.hub.subscribe()
    measuring = asyncio.create_task(station.acquisition.measure())
    await eventually(lambda: station.camera.state is DeviceState.OVERDUE)
    instrument.unplugged = True
    instrument.let_go.set()
    with pytest.raises(DeviceError):
        await measuring
    reported = []
    for _ in range(2):
        event = await asyncio.wait_for(listener.next(), within(20.0))
        assert event is not None
        reported.append(json.loads(event.line)["devices"]["camera"]["state"])
    assert reported == ["overdue", "lost"]


async def test_a_camera_that_is_absent_at_start_is_waited_for(
    instrument: Any, tmp_path: Path, eventually: Eventually
) -> None:
    """The daemon comes up without its camera and takes it when it appears."""
    instrument.unplugged = True
    station = Station(instrument, Journal(tmp_path / "j.sqlite"))
    await station.start()
    assert [alarm.name for alarm in station.alarms.active] == ["camera"]
    instrument.unplugged = False
    await eventually(lambda: station.camera.is_ready)
    assert (await station.acquisition.measure()).sequence == 1
    await station.stop()


async def test_a_light_box_that_comes_back_is_known_to_be_dark(
    station: Station, box: Any, eventually: Eventually
) -> None:
    """Levels set before the loss are not believed after it; that they ended is an alarm until the channel is set."""
    assert await station.light.set_level("red", 0.5) == 0.5
    box.unplugged = True
    await eventually(lambda: [alarm.name for alarm in station.alarms.active] == ["light box"])
    with pytest.raises(DeviceError):
        await station.light.set_level("red", 0.7)
    box.unplugged = False
    await eventually(lambda: [alarm.name for alarm in station.alarms.active] == ["light red"])
    assert station.light.levels == {"white": 0.0, "red": 0.0}
    await station.light.off()
    assert not station.alarms.active


async def test_failed_measurements_put_an_alarm_up(station: Station, instrument: Any, eventually: Eventually) -> None:
    """A saturated scene is reported; when it is over the alarm goes."""
    instrument.failing = True
    station.set_every(0.01)
    await eventually(lambda: [alarm.name for alarm in station.alarms.active] == ["measurement"])
    instrument.failing = False
    await eventually(lambda: not station.alarms.active)


async def test_a_listener_that_falls_behind_is_cut_off(station: Station) -> None:
    """Its queue does not grow; the others go on."""
    slow, quick = station.hub.subscribe(2), station.hub.subscribe(64)
    for _ in range(5):
        await station.acquisition.measure()
    assert slow.closed
    assert await slow.next() is None
    assert not quick.closed


async def test_events_are_in_the_journal(station: Station, instrument: Any, eventually: Eventually) -> None:
    """Loss and return of the camera can be read later."""
    instrument.unplugged = True
    await eventually(lambda: station.alarms.active)
    instrument.unplugged = False
    await eventually(lambda: not station.alarms.active)
    reader = JournalReader(station.journal_path)
    await eventually(lambda: len(reader.events()) == 2)
    assert [event["kind"] for event in reader.events()] == ["alarm", "cleared"]


async def test_ending_continuous_measurement_while_it_fails_ends_nothing_else(
    station: Station, instrument: Any, eventually: Eventually
) -> None:
    """The measurement in hand fails after its period was taken away; the loop that measures goes on."""
    instrument.failing, instrument.let_go = True, threading.Event()
    station.set_every(0.0)
    await eventually(lambda: station.acquisition.busy)
    station.set_every(None)
    instrument.let_go.set()
    await eventually(lambda: not station.acquisition.busy)
    assert (station.failed_task(), station.alarms.active) == (None, ())
    instrument.failing = False
    assert (await station.acquisition.measure(deadline_s=within(20.0))).sequence == 1


async def test_what_is_counted_of_measurements(station: Station, instrument: Any) -> None:
    """Three readings are three committed and three measured, each with its time; a failure is one, and no reading."""
    instrument.measure_s = 0.01
    for _ in range(3):
        await station.acquisition.measure()
    instrument.failing = True
    with pytest.raises(MeasurementError):
        await station.acquisition.measure()
    station.refresh_metrics()
    station.refresh_metrics()  # another look counts nothing twice
    names = ("readings_total", "commit_seconds_count", "measurement_seconds_count", "measurement_failures_total")
    reported = [station.metrics.registry.get_sample_value(f"radiometer_{name}") for name in names]
    assert reported == [3.0, 3.0, 3.0, 1.0]
    measuring = station.metrics.registry.get_sample_value("radiometer_measurement_seconds_sum")
    assert measuring is not None
    assert measuring >= 3 * 0.01


def test_a_hexadecimal_serial_number_is_reported_in_decimal_too() -> None:
    """The state, and with it the page, shows the number as USB reports it and as its label has it."""
    blackfly = identity_mapping(CameraIdentity("FLIR", "BFS-U3-19S4M", "0138C343", "id"))
    assert (blackfly["serial"], blackfly["serial_also"]) == ("0138C343", "20497219")
    assert identity_mapping(CameraIdentity("FLIR", "BFS", "20497219", "id"))["serial_also"] == ""


async def test_another_period_clears_no_alarm_and_its_end_does(station: Station) -> None:
    """What is wrong with measuring is no better for being asked less often; where nothing is asked it is over."""
    station.alarms.put_up("measurement", "every pixel is saturated")
    station.set_every(3600.0)
    assert [alarm.name for alarm in station.alarms.active] == ["measurement"]
    station.set_every(None)
    assert station.alarms.active == ()


async def test_nobody_waits_long_for_a_journal_that_is_known_to_be_blocked(
    station: Station, eventually: Eventually
) -> None:
    """The journal's patience at most instead of two minutes, and the error names the journal's trouble."""
    assert station.acquisition.journal_patience_s == 5.0
    station.acquisition.journal_patience_s = 0.3
    other = sqlite3.connect(station.journal_path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    station.annotate("a remark that cannot be kept")
    await eventually(lambda: station.writer.trouble)
    asked = time.monotonic()
    with pytest.raises(JournalError, match="locked"):
        await station.acquisition.measure()
    assert 0.29 < time.monotonic() - asked < 60.0
    other.execute("ROLLBACK")
    other.close()


async def test_no_kind_of_measurement_waits_for_more_than_two_of_the_others(
    station: Station, instrument: Any, eventually: Eventually
) -> None:
    """Clients that ask without end for patches of their own, and patches with names, leave the shared one its turn."""
    shared, named = Patch(16, 12, 32, 24), {f"p{k}": Patch(k, 0, 2, 2) for k in range(3)}
    station.configure(patch=shared)
    for name, patch in named.items():
        station.patches.define(name, patch)

    async def ask_for_ever(x: int) -> None:
        while True:
            await station.acquisition.measure(replace(station.settings, patch=Patch(x, 20, 2, 2)), 60.0, f"client-{x}")

    clients = [asyncio.create_task(ask_for_ever(x)) for x in range(20, 24)]
    await asyncio.sleep(0)
    station.set_every(0.0)
    await eventually(lambda: len(instrument.measured) > 90)
    station.set_every(None)
    for one in clients:
        one.cancel()
    kinds = ["shared" if s.patch == shared else "named" if s.patch in named.values() else "asked"
             for s in instrument.measured[10:90]]  # fmt: skip
    for kind in ("shared", "named", "asked"):
        turns = [k for k, one in enumerate(kinds) if one == kind]
        assert max(later - earlier for earlier, later in pairwise([-1, *turns, len(kinds)])) <= 3
    assert {s.patch for s in instrument.measured} >= {
        shared,
        *named.values(),
        *(Patch(x, 20, 2, 2) for x in range(20, 24)),
    }


@pytest.mark.parametrize(
    "error", [DeviceLost("gone"), DeviceTimeout("late"), DeviceError("exposure of 0 s"), KeyError(1)]
)
async def test_a_camera_that_fails_at_every_measurement_is_an_alarm_until_a_reading_comes(
    station: Station, instrument: Any, eventually: Eventually, error: Exception
) -> None:
    """However it fails, and however often its port opens again: never "ready", one alarm, a handful of events."""
    measure = instrument.measure
    failures = 0

    def fail(settings: object) -> None:
        nonlocal failures
        failures += 1
        raise error

    instrument.measure = fail
    fail.__name__ = "measure"
    station.set_every(0.01)
    await eventually(lambda: failures)
    await eventually(lambda: station.alarms.active)
    seen = set()
    while failures < 5:
        await asyncio.sleep(0.005)
        seen.add((str(station.camera.state), *station.troubles()))
    assert seen <= {("failing", "camera"), ("lost", "camera")}
    with pytest.raises(RadiometerError):
        await station.acquisition.measure()
    instrument.measure = measure
    await eventually(lambda: station.shown.latest)
    await eventually(lambda: station.troubles() == [])
    reader = JournalReader(station.journal_path)
    await eventually(lambda: [event["kind"] for event in reader.events()][-1:] == ["cleared"])
    assert len(reader.events()) <= 3
    assert station.camera.losses <= 1
