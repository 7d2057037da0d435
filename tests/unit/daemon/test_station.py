"""The core measures, commits before it shows, and survives the loss of devices and journal."""

import asyncio
import json
import sqlite3
import struct
import threading
import time
from dataclasses import replace
from itertools import pairwise

import pytest

from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader
from radiometer.daemon.keeper import DeviceState
from radiometer.daemon.patches import PatchLimits
from radiometer.daemon.station import Station, identity_mapping
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


async def test_continuous_measurement_keeps_its_period(station, eventually):
    """One reading at once and one a period: never more, however long the machine lets it wait."""
    begun = time.monotonic()
    station.set_every(0.05)
    await eventually(lambda: station.shown.latest is not None and station.shown.latest.sequence >= 10)
    assert time.monotonic() - begun > 8.5 * 0.05


@pytest.mark.parametrize("lost", [False, True])
async def test_a_camera_that_does_not_return_is_reported_before_it_gives_up(station, instrument, eventually, lost):
    """While a call hangs the alarm is up; it goes once answers come in time, or a loss is announced as well."""
    instrument.let_go, instrument.late_at = threading.Event(), time.monotonic() + 0.2
    listener = station.hub.subscribe()
    measuring = asyncio.create_task(station.acquisition.measure())
    await eventually(lambda: station.camera.state is DeviceState.OVERDUE)
    assert "has not answered" in station.alarms.active[0].message
    instrument.unplugged = lost
    instrument.let_go.set()
    if not lost:
        await measuring
        instrument.late_at = None
        await eventually(lambda: station.alarms.active == ())
        assert station.camera.losses == 0
        return
    with pytest.raises(DeviceError):
        await measuring
    events = [await asyncio.wait_for(listener.next(), within(20.0)) for _ in range(2)]
    assert [json.loads(one.line)["devices"]["camera"]["state"] for one in events] == ["overdue", "lost"]


async def test_a_camera_that_is_absent_at_start_is_waited_for(instrument, tmp_path, eventually):
    """The daemon comes up without its camera and takes it when it appears."""
    instrument.unplugged = True
    station = Station(instrument, Journal(tmp_path / "j.sqlite"))
    await station.start()
    assert [alarm.name for alarm in station.alarms.active] == ["camera"]
    instrument.unplugged = False
    await eventually(lambda: station.camera.is_ready)
    assert (await station.acquisition.measure()).sequence == 1
    await station.stop()


async def test_a_light_box_that_comes_back_is_known_to_be_dark(station, box, eventually):
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


async def test_a_listener_that_falls_behind_is_cut_off(station):
    """Its queue does not grow; the others go on."""
    slow, quick = station.hub.subscribe(2), station.hub.subscribe(64)
    for _ in range(5):
        await station.acquisition.measure()
    assert slow.closed
    assert await slow.next() is None
    assert not quick.closed


async def test_ending_continuous_measurement_while_it_fails_ends_nothing_else(station, instrument, eventually):
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


async def test_what_is_counted_of_measurements(station, instrument):
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
    assert measuring >= 3 * 0.01


def test_a_hexadecimal_serial_number_is_reported_in_decimal_too():
    """The state, and with it the page, shows the number as USB reports it and as its label has it."""
    blackfly = identity_mapping(CameraIdentity("FLIR", "BFS-U3-19S4M", "0138C343", "id"))
    assert (blackfly["serial"], blackfly["serial_also"]) == ("0138C343", "20497219")
    assert identity_mapping(CameraIdentity("FLIR", "BFS", "20497219", "id"))["serial_also"] == ""


async def test_another_period_clears_no_alarm_and_its_end_does(station):
    """What is wrong with measuring is no better for being asked less often; where nothing is asked it is over."""
    station.alarms.put_up("measurement", "every pixel is saturated")
    station.set_every(3600.0)
    assert [alarm.name for alarm in station.alarms.active] == ["measurement"]
    station.set_every(None)
    assert station.alarms.active == ()


async def test_nobody_waits_long_for_a_journal_that_is_known_to_be_blocked(station, eventually):
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


async def test_no_kind_of_measurement_waits_for_more_than_two_of_the_others(station, instrument, eventually):
    """Clients that ask without end for patches of their own, and patches with names, leave the shared one its turn."""
    shared, named = Patch(16, 12, 32, 24), {f"p{k}": Patch(k, 0, 2, 2) for k in range(3)}
    station.configure(patch=shared)
    for name, patch in named.items():
        station.patches.define(name, patch)

    async def ask_for_ever(x):
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
    station, instrument, eventually, error
):
    """However it fails, and however often its port opens again: never "ready", one alarm, a handful of events."""
    measure = instrument.measure
    failures = 0

    def fail(settings):
        nonlocal failures
        failures += 1
        raise error

    instrument.measure = fail
    fail.__name__ = "measure"
    station.set_every(0.01)
    await eventually(lambda: failures)
    await eventually(lambda: station.alarms.active)
    seen = set()
    while failures < 3:
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


LAMP = Patch(1, 2, 3, 4)

CHANGES = {
    "settings": (lambda s: s.configure(gain_db=6.0), lambda status: status["settings"]["gain_db"], 6.0),
    "a patch": (
        lambda s: s.patches.define("lamp", LAMP),
        lambda status: status["patches"]["lamp"]["patch"]["width"],
        3,
    ),
    "no patch": (lambda s: s.patches.delete("old"), lambda status: "old" in status["patches"], False),
    "limits": (
        lambda s: s.patches.set_limits("old", PatchLimits(hysteresis_rel=0.25)),
        lambda status: status["patches"]["old"]["limits"]["hysteresis_rel"],
        0.25,
    ),
    "a remark": (lambda s: s.annotate("a cloud"), lambda status: status["alarms"], []),
    "the period": (lambda s: s.set_every(3600.0), lambda status: status["every_s"], 3600.0),
    "settings as at first": (lambda s: s.reset(), lambda status: status["settings"]["gain_db"], 0.0),
    "an alarm": (lambda s: s.alarms.put_up("lens", "dusty"), lambda status: status["alarms"][0]["name"], "lens"),
}


@pytest.mark.parametrize("what", CHANGES)
async def test_every_change_is_reported_once_with_the_state_after_it(station, what):
    """Each listener within the program is called, and each subscriber has one line of the new state."""
    change, look, expected = CHANGES[what]
    station.patches.define("old", LAMP)
    subscription, called = station.hub.subscribe(), []
    station.on_change.append(lambda: called.append(1))
    change(station)
    assert called == [1]
    event = await subscription.next()
    station.hub.close()
    assert (event.kind, event.sequence, look(json.loads(event.line))) == ("status", None, expected)
    assert look(station.status()) == expected


@pytest.mark.parametrize(
    ("field", "low", "high", "further"),
    [("gain_db", 0.0, 48.0, {}), ("exposure_s", 1e-5, 30.0, {"auto_exposure": False})],
)
async def test_what_is_at_a_limit_is_allowed_and_what_is_beyond_is_not(station, field, low, high, further):
    """Both ends belong to a range; what is refused changes nothing; an exposure is looked at only where it is used."""
    for value in (low, high):
        assert getattr(station.configure(**further, **{field: value}), field) == value
    before = station.settings
    for value in (low - 0.001 * high, high * 1.001):
        with pytest.raises(SettingOutOfRange, match=f"{low:g} to {high:g}"):
            station.configure(**further, **{field: value})
    with pytest.raises(UsageError, match="64 × 48"):
        station.configure(patch=Patch(60, 0, 10, 10))
    assert station.settings == before
    if further:
        assert station.configure(exposure_s=2 * high, auto_exposure=True).auto_exposure


async def test_settings_as_at_first_forget_a_reading_of_another_patch_only(station):
    """A reset that measures the same keeps what was measured; one that moves the patch has no reading yet."""
    station.configure(gain_db=6.0)
    reading = await station.acquisition.measure()
    station.reset()
    assert (station.shown.latest, station.settings) == (reading, MeasurementSettings())
    station.configure(patch=LAMP)
    moved = await station.acquisition.measure()
    assert station.shown.latest == moved
    station.reset()
    assert (station.shown.latest, station.shown.line, station.shown.measurement) == (None, "", None)


async def test_without_a_box_no_light_is_believed(instrument, tmp_path):
    """A station that has none says so, of one channel and of all, and shows none in its state."""
    alone = Station(instrument, Journal(tmp_path / "journal.sqlite"))
    for call in (alone.light.set_level("red", 0.0), alone.light.off()):
        with pytest.raises(DeviceLost, match="no light box"):
            await call
    assert (alone.light.is_confirmed, alone.status()["light"], list(alone.status()["devices"])) == (
        False,
        {},
        ["camera"],
    )
    with pytest.raises(DeviceError, match="never open"):
        alone.configure(gain_db=1.0)


ALL_X, OTHER_X = 7, 20  # the fake instrument's radiance is 1 + x


async def test_another_clients_patch_is_never_fetched(connect, station, instrument):
    """B measures a patch of its own all the time; A polls and sees the shared patch only, whoever goes first."""
    a, b = await connect(), await connect()
    await a.send(f"SENS:PATC {ALL_X},1,2,3;:TRIG:TIM 0")
    assert float((await a.ask("READ?")).split(",")[0]) == 1.0 + ALL_X
    for _ in range(10):
        other, mine = await asyncio.gather(b.ask(f"MEAS:RAD? {OTHER_X},1,2,3"), a.ask("FETC:RAD?"))
        assert float(other.split(",")[0]) == 1.0 + OTHER_X
        assert float(mine.split(",")[0]) == 1.0 + ALL_X
        assert float((await b.ask("FETC:RAD?")).split(",")[0]) == 1.0 + OTHER_X


async def test_a_one_off_enters_no_shared_interface(station, connect, eventually):
    """Stream, latest value, picture, figures and history of all stay those of the shared patch."""
    listener = station.hub.subscribe()
    await station.acquisition.measure(station.configure(patch=Patch(ALL_X, 1, 2, 3)))
    shared = station.shown.measurement
    client = await connect()
    assert float((await client.ask(f"MEAS:RAD? {OTHER_X},1,2,3")).split(",")[0]) == 1.0 + OTHER_X
    assert (station.shown.latest.patch.x, station.shown.measurement) == (ALL_X, shared)
    await station.acquisition.measure()
    readings = []
    while len(readings) < 2:
        event = await listener.next()
        readings += [json.loads(event.line)] if event is not None and event.kind == "reading" else []
    assert [reading["patch"]["x"] for reading in readings] == [ALL_X, ALL_X]
    assert b'radiometer_radiance{unit="W sr-1 m-2"} 8.0' in station.metrics.render()
    history = await client.ask("TRAC:DATA? HIST,5")
    assert struct.unpack(">3d", history[4:28].encode("latin-1")) == (1.0, 1.0 + ALL_X, 0.01)


async def test_two_that_ask_for_one_patch_share_the_measurement(station, instrument):
    """The reading names both, and no third one."""
    expected = station.settings.__class__(patch=Patch(OTHER_X, 1, 2, 3))
    first, second = await asyncio.gather(
        station.acquisition.measure(expected, session="a"), station.acquisition.measure(expected, session="b")
    )
    assert (first, first.session, len(instrument.measured)) == (second, "a,b", 1)


async def test_a_moved_patch_has_no_reading_yet(client, station):
    """After the shared patch was moved, nothing states the reading of the old place; exposure alone changes nothing."""
    assert await client.ask("READ?")
    await client.send("SENS:EXP 4 MS")
    assert float((await client.ask("FETC?")).split(",")[0]) == 17.0
    assert b"\nradiometer_radiance{" in station.metrics.render()
    await client.send(f"SENS:PATC {ALL_X},1,2,3;:FETC?")
    assert (await client.ask("SYST:ERR?")).startswith("-230")
    assert b"\nradiometer_radiance{" not in station.metrics.render()
    assert float((await client.ask("READ?;:FETC?")).split(";")[1].split(",")[0]) == 1.0 + ALL_X
    await client.send("SENS:CORR:WAV 600;:FETC?")
    assert (await client.ask("SYST:ERR?")).startswith("-230")


async def test_a_patch_moved_while_measuring_is_not_believed(station, instrument, eventually):
    """The reading in hand when the patch moves is kept, but is no one's latest."""
    instrument.let_go = threading.Event()
    begun = asyncio.create_task(station.acquisition.measure())
    await eventually(lambda: station.acquisition.busy)
    station.configure(patch=Patch(ALL_X, 1, 2, 3))
    instrument.let_go.set()
    assert (await begun).patch.x == 16
    assert station.shown.latest is None


async def test_each_session_gets_the_picture_of_its_reading(connect, station):
    """TRAC:DATA? IMAGe after a session's own measurement is its own frame, another's is the shared one."""
    a, b = await connect(), await connect()
    await a.ask("READ?")
    assert station.shown.latest.session == "", "what is measured with the settings in force belongs to all"
    await b.ask(f"SENS:EXP 5 MS;:MEAS:RAD? {OTHER_X},1,2,3")
    assert (await a.ask("TRAC:SIZE?"), await b.ask("TRAC:SIZE?")) == ("64,48,12", "64,48,12")
    await a.ask(f"MEAS:RAD? {OTHER_X + 1},1,2,3")
    await b.send("TRAC:SIZE?")
    assert (await b.ask("SYST:ERR?")).startswith("-230")  # its frames are gone; another's are not given in their stead
