"""A reading is of one patch and belongs to one client, or to all: no one is served another's."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import struct
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import aiohttp

from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, to_csv
from radiometer.daemon.station import Station
from radiometer.data import Flag, Patch, Reading

Eventually = Callable[..., Awaitable[None]]
ALL_X, OTHER_X = 7, 20  # the fake instrument's radiance is 1 + x


async def test_another_clients_patch_is_never_fetched(connect: Any, station: Station, instrument: Any) -> None:
    """B measures a patch of its own all the time; A polls and sees the shared patch only, whoever goes first."""
    a, b = await connect(), await connect()
    await a.send(f"SENS:PATC {ALL_X},1,2,3;:TRIG:TIM 0")
    assert float((await a.ask("READ?")).split(",")[0]) == 1.0 + ALL_X
    for _ in range(10):
        other, mine = await asyncio.gather(b.ask(f"MEAS:RAD? {OTHER_X},1,2,3"), a.ask("FETC:RAD?"))
        assert float(other.split(",")[0]) == 1.0 + OTHER_X
        assert float(mine.split(",")[0]) == 1.0 + ALL_X
        assert float((await b.ask("FETC:RAD?")).split(",")[0]) == 1.0 + OTHER_X


async def test_a_one_off_enters_no_shared_interface(station: Station, connect: Any, eventually: Eventually) -> None:
    """Stream, latest value, picture, figures and history of all stay those of the shared patch."""
    listener = station.hub.subscribe()
    await station.acquisition.measure(station.configure(patch=Patch(ALL_X, 1, 2, 3)))
    shared = station.shown.measurement
    client = await connect()
    assert float((await client.ask(f"MEAS:RAD? {OTHER_X},1,2,3")).split(",")[0]) == 1.0 + OTHER_X
    assert station.shown.latest is not None
    assert (station.shown.latest.patch.x, station.shown.measurement) == (ALL_X, shared)
    await station.acquisition.measure()
    readings: list[Any] = []
    while len(readings) < 2:
        event = await listener.next()
        readings += [json.loads(event.line)] if event is not None and event.kind == "reading" else []
    assert [reading["patch"]["x"] for reading in readings] == [ALL_X, ALL_X]
    assert b'radiometer_radiance{unit="W sr-1 m-2"} 8.0' in station.metrics.render()
    history = await client.ask("TRAC:DATA? HIST,5")
    assert struct.unpack(">3d", history[4:28].encode("latin-1")) == (1.0, 1.0 + ALL_X, 0.01)


async def test_a_one_off_stays_out_of_history_and_stream_of_http(station: Station) -> None:
    """GET /readings and the stream's replay leave it out unless asked for; the journal says whose it is."""
    server = HttpServer(station)
    base = f"http://127.0.0.1:{await server.listen('127.0.0.1', 0)}"
    async with aiohttp.ClientSession() as session:
        await station.acquisition.measure()
        body = {"patch": {"x": OTHER_X, "y": 1, "width": 2, "height": 3}}
        async with session.post(f"{base}/measure", json=body) as reply:
            own = await reply.json()
        await station.acquisition.measure()

        async def numbers(query: str) -> list[int]:
            async with session.get(f"{base}/readings{query}") as reply:
                return [reading["sequence"] for reading in await reply.json()]

        assert (await numbers(""), await numbers("?stream=own"), await numbers("?stream=all")) == (
            [1, 3],
            [2],
            [1, 2, 3],
        )
        async with session.get(f"{base}/readings?stream=mine") as reply:
            assert reply.status == 400
        async with session.get(f"{base}/readings/stream?after=0&format=jsonl") as reply:
            replayed = [json.loads(await reply.content.readline())["sequence"] for _ in range(2)]
    assert replayed == [1, 3]
    assert own["session"].startswith("http-")
    await server.close()


async def test_two_that_ask_for_one_patch_share_the_measurement(station: Station, instrument: Any) -> None:
    """The reading names both, and no third one."""
    expected = station.settings.__class__(patch=Patch(OTHER_X, 1, 2, 3))
    first, second = await asyncio.gather(
        station.acquisition.measure(expected, session="a"), station.acquisition.measure(expected, session="b")
    )
    assert (first, first.session, len(instrument.measured)) == (second, "a,b", 1)


async def test_what_is_measured_with_the_settings_in_force_belongs_to_all(connect: Any, station: Station) -> None:
    """READ? without a patch of its own is everybody's reading: the page shows it."""
    client = await connect()
    await client.ask("READ?")
    assert station.shown.latest is not None
    assert station.shown.latest.session == ""


async def test_a_moved_patch_has_no_reading_yet(client: Any, station: Station) -> None:
    """After the shared patch was moved, FETC? refuses the reading of the old place; exposure alone changes nothing."""
    assert await client.ask("READ?")
    await client.send("SENS:EXP 4 MS")
    assert float((await client.ask("FETC?")).split(",")[0]) == 17.0
    await client.send(f"SENS:PATC {ALL_X},1,2,3;:FETC?")
    assert (await client.ask("SYST:ERR?")).startswith("-230")
    assert float((await client.ask("READ?;:FETC?")).split(";")[1].split(",")[0]) == 1.0 + ALL_X
    await client.send("SENS:CORR:WAV 600;:FETC?")
    assert (await client.ask("SYST:ERR?")).startswith("-230")


async def test_a_patch_moved_while_measuring_is_not_believed(
    station: Station, instrument: Any, eventually: Eventually
) -> None:
    """The reading in hand when the patch moves is kept, but is no one's latest."""
    instrument.let_go = threading.Event()
    begun = asyncio.create_task(station.acquisition.measure())
    await eventually(lambda: station.acquisition.busy)
    station.configure(patch=Patch(ALL_X, 1, 2, 3))
    instrument.let_go.set()
    assert (await begun).patch.x == 16
    assert station.shown.latest is None


async def test_each_session_gets_the_picture_of_its_reading(connect: Any, instrument: Any) -> None:
    """TRAC:DATA? IMAGe after a session's own measurement is its own frame, another's is the shared one."""
    a, b = await connect(), await connect()
    await a.ask("READ?")
    await b.ask(f"SENS:EXP 5 MS;:MEAS:RAD? {OTHER_X},1,2,3")
    assert (await a.ask("TRAC:SIZE?"), await b.ask("TRAC:SIZE?")) == ("64,48,12", "64,48,12")
    await a.ask(f"MEAS:RAD? {OTHER_X + 1},1,2,3")
    await b.send("TRAC:SIZE?")
    assert (await b.ask("SYST:ERR?")).startswith("-230")  # its frames are gone; another's are not given in their stead


def test_the_journal_of_the_version_before_is_taken_over(tmp_path: Path, make_reading: Callable[..., Reading]) -> None:
    """Its readings belong to all, their trend is made up, and new ones are added; it can be read before that too."""
    path = tmp_path / "j.sqlite"
    with Journal(path) as journal:
        journal.append([make_reading(time=f"2026-01-01T00:00:{second:02d}Z") for second in (1, 2, 59)])
        journal.append([make_reading(time="2026-01-01T00:01:00Z", flags=(Flag.FLICKER,))])
    made = sqlite3.connect(path)
    new = made.execute("SELECT * FROM trend").fetchall()
    made.executescript(
        "DROP TABLE trend; DROP TABLE patches; DROP INDEX readings_by_stream;"
        "ALTER TABLE readings DROP COLUMN stream; PRAGMA user_version = 1"
    )
    made.close()
    assert len(JournalReader(path).lines(ReadingFilter(stream=""))) == 4
    assert JournalReader(path).lines(ReadingFilter(stream="own")) == []
    assert JournalReader(path).trend("", 0, 2**61) == []
    with Journal(path) as journal:
        journal.append([make_reading(session="scpi-1"), make_reading()])
    upgraded = sqlite3.connect(path)
    assert upgraded.execute("SELECT * FROM trend ORDER BY minute").fetchall()[:2] == new
    assert upgraded.execute("SELECT sum(count) FROM trend").fetchone() == (5,)
    upgraded.close()


def test_the_table_says_whose_a_reading_is(tmp_path: Path, make_reading: Callable[..., Reading]) -> None:
    """Name and session are columns of the CSV; a reading that belongs to all has neither in its JSON."""
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append([make_reading(), make_reading(name="lamp"), make_reading(session="scpi-3")])
    lines = JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())
    assert [set(json.loads(line)) & {"name", "session"} for line in lines] == [set(), {"name"}, {"session"}]
    assert [row.split(",")[-2:] for row in to_csv(lines).splitlines()[1:]] == [["", ""], ["lamp", ""], ["", "scpi-3"]]
