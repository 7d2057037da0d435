"""pvAccess: a real p4p client reads value, unit, alarm, time stamp, display limits and the map."""

import asyncio
import math
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from radiometer.daemon.epics import PvaOptions, PvaServer
from radiometer.daemon.patches import MAIN, PatchLimits
from radiometer.data import Flag
from radiometer.errors import UsageError
from testing.patience import within


@pytest.fixture
async def served(station):
    """Return a served station and a client of it; one that no one else on this machine can find."""
    from p4p.client.thread import Context  # a second of work for whoever merely collects the tests

    server = PvaServer(station, PvaOptions("lab", isolated=True))
    server.start()
    client = await asyncio.to_thread(Context, "pva", conf=server.settings, useenv=False, nt=False)
    yield server, client
    await asyncio.to_thread(client.close)
    await server.stop()


async def _read(client, name):
    return await asyncio.to_thread(client.get, f"lab:4711:{name}", timeout=within(20.0))


async def test_client_reads_the_reading(served, station, eventually):
    """Value, unit, description, time, no alarm; before any reading the value is invalid; nothing can be written."""
    from p4p.client.thread import RemoteError

    _, client = served
    before = await _read(client, "radiance")
    assert math.isnan(before.value)
    assert (before.alarm.severity, before.alarm.message) == (3, "no reading yet")
    reading = await station.acquisition.measure()
    await eventually(lambda: station.shown.latest is not None)
    found = await _read(client, "radiance")
    assert found.getID().startswith("epics:nt/NTScalar")
    assert found.value == reading.radiance.value == 17.0
    assert found.display.units == "W sr-1 m-2"
    assert found.display.description == "radiance of the patch"
    assert (found.display.limitLow, found.display.limitHigh) == (0.0, 34.0)
    assert found.alarm.severity == 0
    stamp = found.timeStamp.secondsPastEpoch + 1e-9 * found.timeStamp.nanoseconds
    assert stamp == pytest.approx(datetime.fromisoformat(reading.time).timestamp(), abs=1e-5)
    assert (await _read(client, "u_radiance")).value == 0.01
    luminance = await _read(client, "luminance")
    assert (luminance.value, luminance.display.units) == (100.0, "cd m-2")
    assert (await _read(client, "u_luminance")).value == 2.0
    with pytest.raises(RemoteError):
        await asyncio.to_thread(client.put, "lab:4711:radiance", 5.0, timeout=within(20.0))


async def test_alarms_and_limits_are_epics_own(served, station, instrument, eventually):
    """Limits of the patch are those of display and alarm; a broken limit is major, a lost camera invalid."""
    _, client = served
    await station.acquisition.measure()
    station.patches.set_limits(MAIN, PatchLimits(low=1.0, high=10.0))
    for _ in range(2):
        await station.acquisition.measure()
    await eventually(lambda: station.alarms.active)
    found = await _read(client, "radiance")
    assert (found.display.limitLow, found.display.limitHigh) == (1.0, 10.0)
    assert (found.valueAlarm.active, found.valueAlarm.highAlarmLimit) == (True, 10.0)
    assert found.alarm.severity == 2
    assert found.alarm.message == station.alarms.active[0].message
    instrument.unplugged = True
    await eventually(lambda: any(alarm.name == "camera" for alarm in station.alarms.active))
    found = await _read(client, "radiance")
    assert found.alarm.severity == 3
    assert "unplugged" in found.alarm.message


async def test_map_is_an_nt_nd_array(served, station):
    """While somebody watches, each reading brings the radiance of every pixel, row by row."""
    _, client = served
    seen = []
    watching = await asyncio.to_thread(client.monitor, "lab:4711:map", seen.append)
    while not seen:  # until the server knows that it is watched
        reading = await station.acquisition.measure()
        await asyncio.sleep(0.01)
    found = seen[-1]
    assert found.getID().startswith("epics:nt/NTNDArray")
    columns, rows = (axis.size for axis in found.dimension)
    assert (rows, columns) == (48, 64)
    picture = np.asarray(found.value).reshape(rows, columns)
    assert float(picture[reading.patch.slices].mean()) == pytest.approx(reading.radiance.value, rel=1e-4)
    assert {a.name: a.value for a in found.attribute}["unit"] == "W sr-1 m-2"
    await asyncio.to_thread(watching.close)
    await asyncio.to_thread(client.disconnect)  # else p4p keeps the channel for 20 s more


def test_prefix_without_letters_is_misuse():
    """A name with blanks could never be found."""
    with pytest.raises(UsageError, match="no prefix"):
        PvaOptions("two words")


async def test_every_variable_carries_the_alarm(served, station, instrument, eventually):
    """Invalid before a reading and while the camera is lost, none with a sound reading; once it is back none again."""
    _, client = served

    async def severities():
        names = ("radiance", "u_radiance", "luminance", "u_luminance", "flags")
        return {(await _read(client, name)).alarm.severity for name in names}

    assert await severities() == {3}
    await station.acquisition.measure()
    await eventually(lambda: station.shown.latest is not None)
    assert await severities() == {0}
    instrument.unplugged = True
    await eventually(lambda: station.alarms.active)
    assert await severities() == {3}
    instrument.unplugged = False
    await eventually(lambda: not station.alarms.active)
    assert await severities() == {0}


async def test_a_flagged_reading_is_a_minor_alarm(served, station, instrument, monkeypatch, eventually):
    """A reading beyond what its calibration was made for counts, with its flags for the operator to read."""
    _, client = served
    whole = instrument.measure

    def flagged(settings):
        found = whole(settings)
        return replace(found, reading=replace(found.reading, flags=(Flag.DRIFT, Flag.GAIN)))

    monkeypatch.setattr(instrument, "measure", flagged)
    await station.acquisition.measure()
    await eventually(lambda: station.shown.latest is not None)
    found = await _read(client, "radiance")
    assert (found.alarm.severity, found.alarm.message) == (1, f"{Flag.DRIFT},{Flag.GAIN}")
    assert (await _read(client, "flags")).value == f"{Flag.DRIFT},{Flag.GAIN}"


async def test_only_the_limit_that_is_set_alarms(served, station, eventually):
    """An unset limit is NaN without a severity; luminance has no limits; lifting the limit ends the alarm."""
    _, client = served
    for low, high in ((20.0, None), (None, 10.0), (None, None)):
        station.patches.set_limits(MAIN, PatchLimits(low=low, high=high))
        for _ in range(2):
            await station.acquisition.measure()
        unlimited = (low, high) == (None, None)
        await eventually(lambda unlimited=unlimited: station.shown.latest if unlimited else station.alarms.active)
        found = (await _read(client, "radiance")).valueAlarm
        for limit, severity, value in (
            (found.lowAlarmLimit, found.lowAlarmSeverity, low),
            (found.highAlarmLimit, found.highAlarmSeverity, high),
        ):
            assert severity == (0 if value is None else 2)
            assert math.isnan(limit) if value is None else limit == value
        assert found.active is not unlimited
        assert not (await _read(client, "luminance")).valueAlarm.active
        station.patches.set_limits(MAIN, PatchLimits())
        assert (await _read(client, "radiance")).alarm.severity == 0
