"""The light shown is the light that the box confirms; off is reached from every interface."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.instrument import DeviceReport
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_reader import JournalReader
from radiometer.daemon.keeper import DeviceState
from radiometer.daemon.limits import Limits
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.errors import DeviceError, LightEnded
from testing.box_station import box_station, seconds_until
from testing.fake_station import QUICK, HttpClient, LineClient

Eventually = Callable[..., Awaitable[None]]


@pytest.fixture
def _telling(box: Any) -> None:
    """Let the fake box tell its levels when it is asked how it is."""
    box.check = lambda: DeviceReport(30.0, {}, dict(box.levels))


@pytest.mark.usefixtures("_telling")
async def test_a_light_that_the_box_ended_is_not_believed_on(station, client, box, eventually):
    """Level 0 on every interface, an alarm that names the channel, and a line in the journal."""
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


@pytest.mark.usefixtures("_telling")
async def test_light_that_agrees_is_no_alarm(station, box, eventually):
    """What is read back as it was set, to the resolution of its 16 bits, stays without a word."""
    await station.light.set_level("red", 0.91)
    asked = []
    box.check = lambda: asked.append(1) or DeviceReport(30.0, {}, dict(box.levels))
    await eventually(lambda: len(asked) > 2)
    assert station.alarms.active == ()
    assert station.light.levels["red"] == 0.91


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

    def check() -> DeviceReport:
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
    assert station.light.keeper is not None
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


async def test_off_as_the_first_message_does_not_wait(connect, station, box):
    """The pause that vets what lights does not hold up what darkens."""
    await station.light.set_level("red", 0.5)
    one = await connect()
    one_server = station.on_change  # the connection is new: its first message
    assert one_server
    assert await one.ask("OUTPUT:ALL OFF;*OPC?") == "1"
    assert box.levels["red"] == 0.0


async def test_http_switches_all_off(http, station, box):
    """POST /light/off darkens every channel and replies the levels."""
    await station.light.set_level("red", 0.5)
    reply = await http.post("/light/off")
    assert (reply.status, reply.json()) == (200, {"light": {"white": 0.0, "red": 0.0}})
    assert box.levels == {"white": 0.0, "red": 0.0}


async def test_a_channel_that_fails_does_not_keep_the_next_one_lit(station, box):
    """All channels are tried, then the failure is reported."""
    await station.light.set_level("red", 0.5)
    whole = box.set_level

    def failing(channel: str, level: float) -> float:
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
        assert (await http.post("/light/off")).status == 200
    elif way == "scpi":
        assert await (await connect()).ask("OUTP:ALL OFF;*OPC?") == "1"
    else:
        await station.light.set_level("red", 0.0)
    before = len(asked)
    outcomes = await asyncio.gather(*waiting, return_exceptions=True)
    assert box.levels["red"] == 0.0
    assert len(asked) == before
    assert sum(isinstance(one, LightEnded) for one in outcomes) > 20
    assert station.light.keeper is not None
    assert station.light.keeper.state is DeviceState.READY
    assert await station.light.set_level("red", 0.5) == 0.5  # what is asked for afterwards is given


@pytest.fixture
def asked(box: Any) -> list[float]:
    """Let the fake box take 30 ms for a level, and return the levels that it is asked for."""
    levels: list[float] = []

    def slow(channel: str, level: float) -> float:
        time.sleep(0.03)
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
