"""Alarms go up by their cause and down by its end; the light shown is the light that the box confirms."""

import asyncio
import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.daemon.alarms import KINDS, Alarms, Lateness
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.instrument import DeviceReport
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_reader import JournalReader
from radiometer.daemon.keeper import DeviceState
from radiometer.daemon.limits import Limits
from radiometer.daemon.patches import PatchLimits
from radiometer.daemon.resources import Descriptors
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.data import Patch, Quantity
from radiometer.errors import CalibrationError, DeviceError, LightEnded, MeasurementError
from testing.box_station import box_station, seconds_until
from testing.fake_station import QUICK, HttpClient, LineClient

ROOT = Path(__file__).resolve().parents[3]
LAMP = Patch(5, 6, 7, 8)


@dataclass
class World:
    """A station and what it stands on, to be broken and corrected."""

    station: Station
    instrument: Any
    box: Any

    def fail(self, patch):
        """Let one patch be saturated."""
        whole = self.instrument.measure

        def measure(settings):
            if settings.patch == patch:
                raise MeasurementError("every pixel is saturated")
            return whole(settings)

        self.instrument.measure = measure

    def heal(self):
        del self.instrument.measure

    def hide_journal(self, *, hidden):
        path = self.station.journal_path
        names = [path, path.with_name("elsewhere.sqlite")]
        names[not hidden].rename(names[hidden])

    async def reload(self, error):
        def reload_calibration():
            if error is not None:
                raise error
            return "calibration.yaml"

        self.instrument.reload_calibration = reload_calibration
        try:
            await self.station.reload_calibration()
        except CalibrationError:
            return


def _do(obj, name, value):
    setattr(obj, name, value)


# By the name of an alarm: what breaks, and what mends. "mqtt" and "period" have modules of tests of their own.
CASES = {
    "camera": (lambda w: _do(w.instrument, "unplugged", True), lambda w: _do(w.instrument, "unplugged", False)),
    "light box": (lambda w: _do(w.box, "unplugged", True), lambda w: _do(w.box, "unplugged", False)),
    "light red": (
        lambda w: _do(w.box, "check", lambda: DeviceReport(30.0, {}, {"red": 0.25})),
        lambda w: (_do(w.box, "check", lambda: DeviceReport(30.0)), w.station.light.off())[1],
    ),
    "journal": (lambda w: w.hide_journal(hidden=True), lambda w: w.hide_journal(hidden=False)),
    "measurement": (lambda w: w.fail(None), World.heal),
    "measurement lamp": (lambda w: w.fail(LAMP), World.heal),
    "reading": (lambda w: w.fail(None), World.heal),
    "reading lamp": (lambda w: w.fail(LAMP), World.heal),
    "limit lamp": (
        lambda w: w.station.patches.set_limits("lamp", PatchLimits(high=1.0)),
        lambda w: w.station.patches.set_limits("lamp", PatchLimits(high=99.0)),
    ),
    "stopped": (
        lambda w: (w.station.patches.set_limits("lamp", PatchLimits(high=99.0)), w.station.set_every(None)),
        lambda w: w.station.set_every(0.05),
    ),
    "calibration": (lambda w: w.reload(CalibrationError("no calibration")), lambda w: w.reload(None)),
    "descriptors": (
        lambda w: Descriptors(w.station.alarms).take_error(
            asyncio.get_running_loop(), {"message": "socket.accept() out of system resource"}
        ),
        lambda w: Descriptors(w.station.alarms).look(),
    ),
}


def _kind(name):
    """Return the kind of an alarm as the table has it."""
    for word in ("lamp", "red"):
        name = name.replace(word, {"lamp": "PATCH", "red": "CHANNEL"}[word])
    return name


def test_every_alarm_is_tested_and_documented():
    """The table of docs/reference/daemon.md is that of the program, line by line."""
    assert {_kind(name) for name in CASES} | {"mqtt", "period"} == {kind.name for kind in KINDS}
    text = (ROOT / "docs" / "reference" / "daemon.md").read_text(encoding="utf-8")
    for kind in KINDS:
        assert f"| `{kind.name}` | {kind.cause} | {kind.end} |" in text


@pytest.mark.parametrize("name", CASES)
async def test_an_alarm_is_up_as_long_as_its_cause(name, station, instrument, box, serve, eventually):
    """Health, state and every listener have it; then it goes, and the journal has both."""
    station.lateness.missing_s = 0.3
    world, http = World(station, instrument, box), await serve(limits=Limits(http_requests_per_s=1e4))

    async def health():
        reply = await http.get("/healthz")
        return reply.status, reply.json()["alarms"]

    async def until(*, up):
        async with asyncio.timeout(60):
            while (name in (await health())[1]) is not up:
                await asyncio.sleep(0.01)

    station.patches.define("lamp", LAMP)
    station.set_every(0.01)
    await eventually(lambda: station.shown.latest and station.patches.latest_of("lamp"))
    assert await health() == (200, [])
    listener = station.hub.subscribe(10_000)
    for step, up in zip(CASES[name], (True, False), strict=True):
        done = step(world)
        if asyncio.iscoroutine(done):
            await done
        await until(up=up)
        status, alarms = await health()
        assert status == (503 if alarms else 200)
    async with asyncio.timeout(60):
        while await health() != (200, []):
            await asyncio.sleep(0.01)
    reported = set()
    while name not in reported and (event := await listener.next()) is not None:
        reported |= {alarm["name"] for alarm in json.loads(event.line)["alarms"]} if event.kind == "status" else set()
    assert name in reported


async def test_no_number_of_the_camera_makes_anything_but_json(station, instrument, serve, eventually, monkeypatch):
    """NaN and infinity in a reading, in a temperature, in counters and in the calibration: null on every interface."""

    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    whole = instrument.measure

    def measure(settings):
        made = whole(settings)
        odd = Quantity(math.nan, math.inf, "W sr-1 m-2")
        return replace(made, reading=replace(made.reading, radiance=odd, luminance=odd, exposures_s=(math.nan,)))

    instrument.measure = measure
    instrument.check = lambda: DeviceReport(math.nan, {"frames": math.inf})
    monkeypatch.setattr(type(instrument), "calibration_summary", property(lambda self: {"created": math.nan}))
    http, listener = await serve(limits=Limits(http_requests_per_s=1e4)), station.hub.subscribe(10_000)
    station.patches.define("lamp", LAMP)
    station.set_every(0.01)
    await eventually(lambda: station.patches.latest_of("lamp"))
    station.set_every(None)
    await eventually(lambda: math.isnan(station.camera.report.temperature_c or 0.0))
    for path in ("status", "readings?stream=all", "readings?format=jsonl", "trend", "events", "response", "healthz"):
        reply = await http.get(f"/{path}")
        assert reply.status in (200, 503)
        for line in reply.text.splitlines() if "jsonl" in path else [reply.text]:
            json.loads(line, parse_constant=refuse)
    odd_settings = {"auto_exposure": True, "exposure_s": math.nan}
    assert (await http.post("/settings", json=odd_settings)).status == 400
    assert (await http.get("/metrics")).status == 200
    for _ in range(4):  # as many come at least: of the patch, of its two readings, of the end of measuring
        event = await listener.next()
        json.loads(event.line, parse_constant=refuse)


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"SYST:HELP:HEAD?\n" * 2000,
        b"GET /readings/stream HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /readings/stream?format=jsonl HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /readings?format=csv&stream=all HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20,
        b"GET /frame.png?width=2048 HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20,
        b"POST /measure HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 90\r\n\r\n{",
    ],
    ids=["replies", "events", "lines", "table", "pictures", "half a body"],
)
async def test_clients_that_do_not_read_delay_no_reading(station, scpi, serve, instrument, eventually, request_bytes):
    """Ten of each kind ask and never read, nor finish what they send; the shared patch is measured on and on."""
    http = await serve(limits=Limits(http_requests_per_s=1e4))
    ports = {True: http.port, False: await scpi.listen_tcp("127.0.0.1", 0)}
    instrument.measure_s = 0.0
    station.set_every(0.0)
    deaf = []
    for _ in range(10):
        _, writer = await asyncio.open_connection("127.0.0.1", ports[b"HTTP" in request_bytes], limit=1024)
        writer.transport.pause_reading()
        writer.write(request_bytes)
        deaf.append(writer)
    begun = station.shown.latest.sequence if station.shown.latest else 0
    await eventually(lambda: station.shown.latest and station.shown.latest.sequence > begun + 60)
    assert station.troubles() == []
    for writer in deaf:
        writer.transport.abort()


# A period that is not kept, and readings that stay away, are alarms; hours pass in no time.


class _Bench:
    """Lets time pass in steps, with a measurement begun and a reading come every so often."""

    def __init__(self, every_s):
        self.now = 1000.0
        self.changes = []
        self.alarms = Alarms(lambda kind, name, message: self.changes.append((kind, name)))
        self.lateness = Lateness(self.alarms, clock=lambda: self.now)
        self.lateness.follow(every_s)

    @property
    def up(self):
        return {alarm.name for alarm in self.alarms.active}

    def measure(self, pace_s, count, *, reads=True):
        for _ in range(count):
            self.lateness.begun("shared")
            if reads:
                self.lateness.came("main")
            for _ in range(4):
                self.now += pace_s / 4
                self.lateness.look()

    def wait(self, seconds, *, able=True, paused=False):
        end = self.now + seconds
        while self.now < end:
            self.now += 0.5
            self.lateness.look(able=able, paused=paused)


@given(every_s=st.floats(0.05, 3600.0), slower=st.floats(1.0, 1.05))
def test_a_period_that_is_kept_is_no_alarm(every_s, slower):
    """Neither is a machine that is a little late at every turn."""
    bench = _Bench(every_s)
    bench.measure(slower * every_s, max(20, round(25 / every_s)))
    assert bench.changes == []


@given(every_s=st.floats(0.05, 3600.0), slower=st.floats(1.8, 4.5))
def test_a_period_that_is_not_kept_is_one_alarm_until_it_is(every_s, slower):
    """It does not flap at a steady pace; its end needs the pace that was asked for."""
    bench = _Bench(every_s)
    bench.measure(slower * every_s, max(20, round(25 / every_s)))
    assert bench.changes == [("alarm", "period")]
    bench.measure(every_s, max(20, round(25 / every_s)))
    assert bench.changes == [("alarm", "period"), ("cleared", "period")]


@pytest.mark.parametrize(("every_s", "after_s"), [(0.0, 10.0), (1.0, 10.0), (60.0, 300.0)])
def test_only_a_reading_ends_the_alarm_that_none_comes(every_s, after_s):
    """Five periods and ten seconds after the last one; measurements that begin and come to nothing end nothing."""
    bench = _Bench(every_s)
    bench.measure(max(every_s, 0.1), 3)
    bench.wait(after_s - max(every_s, 0.1) - 0.6, able=False)
    assert bench.up == set()
    bench.wait(2.0, able=False)
    assert bench.up == {"reading"}
    bench.measure(max(every_s, 0.1), 20, reads=False)
    assert "reading" in bench.up
    bench.lateness.came("main")
    assert "reading" not in bench.up


def test_a_pause_for_the_journal_is_no_lack_of_readings():
    """Hours of a pause miss nothing, without a camera readings alone; a patch with a name is missed by its name."""
    bench = _Bench(1.0)
    bench.measure(1.0, 3)
    bench.wait(3600.0, paused=True)
    assert bench.changes == []
    bench.wait(9.5)
    assert bench.up == set()
    bench.wait(2.0)
    assert "reading" in bench.up
    bench = _Bench(1.0)
    bench.wait(3600.0, able=False)
    assert bench.up == {"reading"}
    bench.measure(1.0, 30)
    assert bench.up == set()
    bench = _Bench(1.0)
    for name in ("lamp", "wall"):
        bench.lateness.expect(name)
    bench.measure(1.0, 12)
    assert bench.up == {"reading lamp", "reading wall"}
    bench.lateness.forget("lamp")
    assert bench.up == {"reading wall"}
    bench.lateness.follow(None)
    bench.wait(100.0)
    assert bench.up == set()


# The light shown is the light that the box confirms; off is reached from every interface.


async def test_a_light_that_the_box_ended_is_not_believed_on(station, client, box, eventually):
    """Level 0 on every interface, an alarm that names the channel, and a line in the journal."""
    box.check = lambda: DeviceReport(30.0, {}, dict(box.levels))
    await station.light.set_level("red", 0.91)
    box.levels["red"] = 0.0  # the firmware's energy budget is used up
    await eventually(lambda: station.light.levels["red"] == 0.0)
    assert station.status()["light"] == {"white": 0.0, "red": 0.0}
    assert float(await client.ask("SOUR:LED2:LEV?")) == 0.0
    (alarm,) = station.alarms.active
    assert (alarm.name, "0.91" in alarm.message, "energy budget" in alarm.message) == ("light red", True, True)
    reader = JournalReader(station.journal_path)
    await eventually(lambda: any("went dark by itself" in event["message"] for event in reader.events()))
    await station.light.set_level("red", 0.2)
    assert station.alarms.active == ()


async def test_a_stated_limit_is_accepted_with_what_is_lit_already(tmp_path):
    """The light of one channel uses up what others may give: their limits fall at once, and none is refused."""
    async with box_station(tmp_path) as (station, _, _):
        await seconds_until(lambda: station.status()["light_limits"])
        before = station.status()["light_limits"]
        for channel in ("field", "spot", "fixation"):
            limit = station.status()["light_limits"][channel]
            assert await station.light.set_level(channel, limit) == pytest.approx(limit, abs=1e-4)
        assert station.status()["light_limits"]["spot"] < before["spot"]


@pytest.mark.parametrize(("off", "alarmed"), [(1.0 / 65535.0, True), (-1.0 / 65535.0, True), (0.5e-6, False)])
async def test_light_that_is_off_by_one_step_of_the_box_is_an_alarm(station, box, eventually, off, alarmed):
    """A level is one of 65,535: what is read back is the same number or it is another light."""
    await station.light.set_level("red", 0.5)
    looks = 0

    def check():
        nonlocal looks
        looks += 1
        return DeviceReport(30.0, {}, {"red": 0.5 + off})

    box.check = check
    await eventually(lambda: looks > 1)
    assert [alarm.name for alarm in station.alarms.active] == ["light red"] * alarmed
    assert station.light.levels["red"] == (0.5 + off if alarmed else 0.5)


async def test_the_level_of_a_lost_box_is_unconfirmed(station, client, box, eventually):
    """While the box does not answer no level is shown: null in the state, -230 over SCPI."""
    await station.light.set_level("red", 0.5)
    assert (station.status()["light"]["red"], station.status()["light_confirmed"]) == (0.5, True)
    box.unplugged = True
    await eventually(lambda: station.light.keeper.state is DeviceState.LOST)
    assert (station.status()["light"]["red"], station.status()["light_confirmed"]) == (None, False)
    await client.send("*CLS")
    for question in ("SOUR:LED2:LEV?", "OUTP:ALL?"):
        await client.send(question)
        assert (await client.ask("SYST:ERR?")).startswith("-230")


async def test_the_journal_reports_when_light_went_on_and_off(station, eventually):
    """Each change between dark and lit is one event; a change of level is none."""
    for level in (0.25, 0.5, 0.0, 0.0):
        await station.light.set_level("red", level)
    reader = JournalReader(station.journal_path)
    await eventually(lambda: len([e for e in reader.events() if e["kind"] == "light"]) >= 2)
    reported = [event["message"] for event in reader.events() if event["kind"] == "light"]
    assert reported == ["red lit at 0.25", "red switched off"]


async def test_scpi_switches_all_off(client, box):
    """OUTP:ALL OFF darkens every channel; ON has no meaning and is refused; the query reports."""
    assert float(await client.ask("SOUR:LED2:LEV 0.5;:SOUR:LED1:LEV 0.5;LEV?")) == 0.5
    assert await client.ask("OUTP:ALL?") == "1"
    await client.send("OUTP:ALL ON")
    assert (await client.ask("SYST:ERR?")).startswith("-221")
    assert await client.ask("OUTP:ALL OFF;ALL?") == "0"
    assert box.levels == {"white": 0.0, "red": 0.0}


async def test_a_channel_that_fails_does_not_keep_the_next_one_lit(station, box):
    """All channels are tried, then the failure is reported."""
    await station.light.set_level("red", 0.5)
    whole = box.set_level

    def failing(channel, level):
        if channel == "white":
            raise DeviceError("its driver is hot")
        return float(whole(channel, level))

    box.set_level = failing
    with pytest.raises(DeviceError, match="hot"):
        await station.light.off()
    assert box.levels["red"] == 0.0
    assert json.dumps(station.status())


@pytest.mark.parametrize("way", ["http", "scpi", "channel"])
async def test_darkness_comes_before_all_light_that_waits(way, station, box, asked, connect, http):
    """40 requests for light wait for a slow box: off is what it is asked next, and none of them is lit after."""
    waiting = [asyncio.ensure_future(station.light.set_level("red", 0.2 + 0.01 * n)) for n in range(40)]
    while not asked:
        await asyncio.sleep(0.005)
    if way == "http":
        reply = await http.post("/light/off")
        assert (reply.status, reply.json()) == (200, {"light": {"white": 0.0, "red": 0.0}})
    elif way == "scpi":
        assert await (await connect()).ask("OUTP:ALL OFF;*OPC?") == "1"
    else:
        await station.light.set_level("red", 0.0)
    before = len(asked)
    outcomes = await asyncio.gather(*waiting, return_exceptions=True)
    assert box.levels["red"] == 0.0
    assert len(asked) == before
    assert sum(isinstance(one, LightEnded) for one in outcomes) > 20
    assert station.light.keeper.state is DeviceState.READY
    assert await station.light.set_level("red", 0.5) == 0.5  # what is asked for afterwards is given


@pytest.fixture
def asked(box):
    """Let the fake box take 10 ms for a level, and return the levels that it is asked for."""
    levels = []

    def slow(channel, level):
        time.sleep(0.01)
        levels.append(level)
        box.levels[channel] = level
        return level

    box.set_level = slow
    return levels


@pytest.mark.parametrize("way", ["all", "channel", "other program"])
async def test_light_that_waits_in_a_connection_is_ended_too(way, connect, client, box, asked, eventually):
    """Of 8 clients that send 100 messages each at once, more than are read, none lights once another one said off."""
    box.switched_off = 0
    clients = [await connect() for _ in range(8)]
    for one in clients:
        await one.send("\n".join(["SOUR:LED2:LEV 0.5"] * 100))
    await eventually(lambda: asked)
    if way == "other program":
        box.switched_off += 1
        box.levels["red"] = 0.0
    else:
        assert await client.ask("OUTP:ALL OFF;*OPC?" if way == "all" else "SOUR:LED2:LEV 0;*OPC?") == "1"
        assert len(asked) < 20
    before = len(asked)
    assert [await one.ask("*OPC?") for one in clients] == ["1"] * 8
    assert asked[before:] in ([], [0.5])[: 2 if way == "other program" else 1]  # one of them had begun
    assert "darkened before its light began" in await clients[0].ask("SYST:ERR?")
    assert float(await clients[0].ask("SOUR:LED2:LEV 0.25;LEV?")) == 0.25  # what is asked for afterwards is given


async def test_a_client_may_light_after_its_own_darkness_in_one_go(client, asked):
    """Messages of one client are a program: its own off ends nothing that stands after it."""
    await client.send("SOUR:LED2:LEV 0.5\nOUTP:ALL OFF\nSOUR:LED2:LEV 0.25\nSOUR:LED2:LEV 0\nSOUR:LED2:LEV 0.125")
    assert float(await client.ask("SOUR:LED2:LEV?")) == 0.125
    assert [level for level in asked if level] == [0.5, 0.25, 0.125]
    assert (await client.ask("SYST:ERR?")).startswith("0")


async def test_light_that_waits_for_its_rate_is_ended_too(serve, box, asked):
    """New connections wait their turn; darkness overtakes them, and none of them is lit after."""
    http = await serve(limits=Limits(http_requests_per_s=20.0))

    async def light():
        client = HttpClient(http.port)
        async with client.session:
            return (await client.post("/light", json={"channel": "red", "level": 0.5})).status

    waiting = [asyncio.ensure_future(light()) for _ in range(40)]
    while len(asked) < 2:
        await asyncio.sleep(0.005)
    assert (await http.post("/light/off")).status == 200
    before, statuses = len(asked), await asyncio.gather(*waiting)
    assert (box.levels["red"], asked[before:]) == (0.0, [])
    assert statuses.count(409) > 20
    assert await light() == 200


@pytest.mark.parametrize("reached", [False, True])
async def test_darkness_of_a_box_that_does_not_answer_is_an_error(tmp_path, instrument, box, eventually, reached):
    """Whether it was ever reached or not: nobody knows that it is dark, on either interface."""
    channels, box.channels = box.channels, (box.channels if reached else ())
    box.unplugged = not reached
    station = Station(instrument, Journal(tmp_path / "other.sqlite"), box=box, times=QUICK)
    await station.start()
    box.unplugged = True
    await eventually(lambda: station.light.keeper and station.light.keeper.state is not DeviceState.READY)
    server, scpi = HttpServer(station), ScpiServer(station)
    http = HttpClient(await server.listen("127.0.0.1", 0))
    async with http.session:
        reply = await http.post("/light/off")
    assert (reply.status, "unplugged" in reply.text) == (503, True)
    line = LineClient(*await asyncio.open_connection("127.0.0.1", await scpi.listen_tcp("127.0.0.1", 0)))
    await line.send("*CLS;:OUTP:ALL OFF")
    assert (await line.ask("SYST:ERR?")).startswith("-24")
    box.channels, box.unplugged = channels, False
    line.writer.close()
    await server.close()
    await scpi.close()
    await station.stop()
