"""The HTTP interface: history, stream, picture, settings, description, and who is refused."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any, get_args

import aiohttp
import numpy as np
import pytest
from pydantic import BaseModel

from radiometer.daemon.http.openapi import description
from radiometer.daemon.http.server import ROUTES, HttpServer
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.limits import Limits
from radiometer.daemon.station import Station
from radiometer.data import Patch, Reading, ResponseCurve
from radiometer.errors import OutputError
from testing.patience import within

Eventually = Callable[..., Awaitable[None]]


@pytest.fixture
async def session() -> AsyncIterator[aiohttp.ClientSession]:
    """Return a client session."""
    async with aiohttp.ClientSession() as client:
        yield client


@pytest.fixture
async def serve(station: Station) -> AsyncIterator[Callable[..., Awaitable[str]]]:
    """Return a starter of HTTP servers that gives their base address."""
    servers: list[HttpServer] = []

    async def start(**options: Any) -> str:
        servers.append(HttpServer(station, **options))
        return f"http://127.0.0.1:{await servers[-1].listen('127.0.0.1', 0)}"

    yield start
    for server in servers:
        await server.close()


@pytest.fixture
async def base(serve: Any) -> str:
    """Return the address of a server with default limits."""
    return str(await serve())


async def test_measure_replies_the_documented_reading(
    base: str, session: aiohttp.ClientSession, station: Station
) -> None:
    """POST /measure measures the patch asked for; the reply is the journal's line, and only the asker's."""
    body = {"patch": {"x": 3, "y": 4, "width": 5, "height": 6}}
    async with session.post(f"{base}/measure", json=body) as reply:
        reading = await reply.json()
    assert reply.status == 200
    (line,) = JournalReader(station.journal_path).lines(ReadingFilter(stream="own"))
    assert reading == json.loads(line)
    assert station.shown.latest is None
    assert (reading["patch"], reading["radiance"]["value"]) == (body["patch"], 4.0)
    assert station.settings.patch is None


async def test_history_filters(base: str, session: aiohttp.ClientSession, station: Station) -> None:
    """`limit` keeps the newest, `after` begins with the oldest above it."""
    for _ in range(5):
        await station.acquisition.measure()

    async def numbers(query: str) -> list[int]:
        async with session.get(f"{base}/readings?{query}") as reply:
            return [reading["sequence"] for reading in await reply.json()]

    assert await numbers("limit=2") == [4, 5]
    assert await numbers("after=1&limit=2") == [2, 3]
    assert await numbers("until=1h") == []
    assert len(await numbers("since=1h&clean=true")) == 5
    assert await numbers("flag=saturated") == []


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("/readings?limit=0", "limit must be 1 to"),
        ("/readings?limit=abc", "whole number"),
        ("/readings?since=yesterday", "ISO 8601"),
        ("/readings?format=xml", "format must be one of"),
        ("/readings?nonsense=1", "no parameter 'nonsense'"),
        ("/readings?limit=20001", "limit must be 1 to 20000"),
        ("/readings?clean=maybe", "clean"),
        ("/readings?stream=lamp", "stream"),
        ("/readings?after=9223372036854775808", "after"),
        ("/trend?points=9", "points must be 10 to 5000"),
        ("/trend?points=5001", "points must be 10 to 5000"),
        ("/events?limit=0", "limit must be 1 to 5000"),
        ("/events?limit=5001", "limit must be 1 to 5000"),
        ("/frame.png?width=63", "width must be 64 to 2048"),
        ("/frame.png?width=2049", "width must be 64 to 2048"),
    ],
)
async def test_wrong_queries_are_refused_with_the_reason(
    base: str, session: aiohttp.ClientSession, path: str, message: str
) -> None:
    """Status 400 and JSON that says what is allowed."""
    async with session.get(base + path) as reply:
        content = await reply.json()
    assert reply.status == 400
    assert message in content["error"]["message"]


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b'{"patch": {"x": 1}}', 400),
        (b'{"patch": {"x": 1.5, "y": 2, "width": 3, "height": 4}}', 400),
        (b'{"nonsense": 1}', 400),
        (b"{", 400),
        (b'{"patch": {"x": 60, "y": 0, "width": 10, "height": 10}}', 400),
        (b'{"exposure_s": 1e9}', 400),
        (b'{"gain_db": -1}', 400),
        (b"x" * 16_385, 413),  # one byte over 16 KiB
    ],
)
async def test_wrong_bodies_are_refused_and_change_nothing(
    base: str, session: aiohttp.ClientSession, station: Station, body: bytes, status: int
) -> None:
    """Out of range, unknown, malformed or too large."""
    before = station.settings
    for path in ("/measure", "/settings"):
        async with session.post(base + path, data=body, headers={"Content-Type": "application/json"}) as reply:
            assert reply.status == status, await reply.text()
    assert station.settings == before
    assert station.shown.latest is None


def _numbers(model: type[BaseModel]) -> dict[str, Any]:
    """Return the fields of a body that take numbers and no text, with those of its parts, as the body's keys."""
    found: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        kinds = get_args(field.annotation) or (field.annotation,)
        parts = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
        found |= {f"{name}.{key}": kind for part in parts for key, kind in _numbers(part).items()}
        found |= {name: field.annotation} if {int, float} & set(kinds) else {}
    return found


@pytest.mark.parametrize("wrong", ["0.5", "1", "NaN", "", True, False, [1], {"value": 1}])
@pytest.mark.parametrize(
    ("path", "key"), [(one.path, key) for one in ROUTES if one.body is not None for key in _numbers(one.body)]
)
async def test_what_is_no_number_is_refused_in_every_body(
    base: str, session: aiohttp.ClientSession, path: str, key: str, wrong: Any
) -> None:
    """Text, truth values and lists in place of each number of each request: 400, and the key is named."""
    outer, _, inner = key.partition(".")
    async with session.post(base + path, json={outer: {inner: wrong} if inner else wrong}) as reply:
        assert reply.status == 400
        assert (
            "number" in await reply.text() or "integer" in await reply.text() or "Field required" in await reply.text()
        )


async def test_the_stream_replays_and_follows_without_gap(
    base: str, session: aiohttp.ClientSession, station: Station
) -> None:
    """A client that reconnects with Last-Event-ID gets every reading once, in order."""
    station.set_every(0.005)
    while station.shown.latest is None or station.shown.latest.sequence < 10:
        await asyncio.sleep(0.01)
    numbers: list[int] = []
    async with session.get(f"{base}/readings/stream", headers={"Last-Event-ID": "3"}) as reply:
        assert reply.content_type == "text/event-stream"
        async for raw in reply.content:
            if raw.startswith(b"data: ") and b'"radiance"' in raw:
                numbers.append(json.loads(raw[6:])["sequence"])
            if len(numbers) == 40:
                break
    assert numbers == list(range(4, 44))


async def test_the_stream_as_json_lines(base: str, session: aiohttp.ClientSession, station: Station) -> None:
    """Each line is a reading."""
    await station.acquisition.measure()
    async with session.get(f"{base}/readings/stream", params={"format": "jsonl", "after": "0"}) as reply:
        line = await asyncio.wait_for(reply.content.readline(), within(20.0))
    assert station.shown.latest is not None
    assert json.loads(line) == station.shown.latest.to_mapping()


async def test_a_loss_is_pushed_to_listeners(
    base: str, session: aiohttp.ClientSession, station: Station, instrument: Any
) -> None:
    """An event named status reports the alarm; health turns 503; metrics say 0."""
    async with session.get(f"{base}/readings/stream") as stream:
        instrument.unplugged = True
        async with asyncio.timeout(within(20.0)):
            while (await stream.content.readline()) != b"event: status\n":
                pass
        status = json.loads((await stream.content.readline())[6:])
    assert [alarm["name"] for alarm in status["alarms"]] == ["camera"]
    async with session.get(f"{base}/healthz") as health:
        assert (health.status, await health.json()) == (503, {"status": "alarm", "alarms": ["camera"]})
    async with session.get(f"{base}/metrics") as metrics:
        assert 'radiometer_device_up{device="camera"} 0.0' in await metrics.text()
    async with session.post(f"{base}/measure") as refused:
        assert refused.status == 503


async def test_metrics_hold_what_an_operator_watches(
    base: str, session: aiohttp.ClientSession, station: Station, eventually: Eventually
) -> None:
    """Readings, latency, exposure, lost packets, retries, temperature, queue depth."""
    await station.acquisition.measure()
    await eventually(lambda: station.camera.report.counters.get("frames"))
    async with session.get(f"{base}/metrics") as reply:
        text = await reply.text()
    for line in (
        "radiometer_readings_total 1.0",
        "radiometer_measurement_seconds_count 1.0",
        "radiometer_exposure_seconds 0.01",
        "radiometer_lost_packets_total 3.0",
        "radiometer_retries_total 0.0",
        'radiometer_temperature_celsius{device="camera"} 41.5',
        'radiometer_queue_depth{queue="journal"} 0.0',
        "process_resident_memory_bytes ",
    ):
        assert line in text


async def test_settings_change_and_are_reported(
    base: str, session: aiohttp.ClientSession, station: Station, box: Any
) -> None:
    """What is left out stays; an exposure switches automatic exposure off; null stops continuous measurement."""
    async with session.post(f"{base}/settings", json={"exposure_s": 0.02, "every_s": 5}) as reply:
        status = await reply.json()
    assert (status["settings"]["auto_exposure"], status["every_s"]) == (False, 5.0)
    async with session.post(f"{base}/settings", json={"every_s": None}) as reply:
        status = await reply.json()
    assert (status["settings"]["exposure_s"], status["every_s"]) == (0.02, None)
    async with session.post(f"{base}/light", json={"channel": "red", "level": 0.25}) as reply:
        assert (reply.status, box.levels["red"]) == (200, 0.25)
    async with session.post(f"{base}/light", json={"channel": "blue", "level": 0.25}) as reply:
        assert reply.status == 400


async def test_the_description_covers_every_route(base: str, session: aiohttp.ClientSession) -> None:
    """OpenAPI lists each path and method that is served, every reference resolves, and it is served itself."""
    async with session.get(f"{base}/openapi.json") as reply:
        served = await reply.json()
    assert served == json.loads(json.dumps(description(ROUTES)))
    assert {(path, method) for path, entry in served["paths"].items() for method in entry} == {
        (route.path, route.method.lower()) for route in ROUTES
    }
    references = {part.split('"')[0] for part in json.dumps(served).split("#/components/schemas/")[1:]}
    assert references <= set(served["components"]["schemas"])


@pytest.mark.parametrize(
    "path", [route.path for route in ROUTES if route.method == "GET" and "stream" not in route.path]
)
async def test_every_get_route_answers(base: str, session: aiohttp.ClientSession, station: Station, path: str) -> None:
    """Status 200, the content type that the table says, and the security headers."""
    await station.acquisition.measure()
    (route,) = [entry for entry in ROUTES if (entry.method, entry.path) == ("GET", path)]
    async with session.get(base + path) as reply:
        assert reply.status == 200
        assert reply.content_type == route.reply
        assert "default-src 'none'" in reply.headers["Content-Security-Policy"]


async def test_the_page_needs_nothing_from_outside(base: str, session: aiohttp.ClientSession) -> None:
    """No part of the page names another host."""
    for path in ("/", "/page.js", "/trends.js", "/response.js", "/page.css"):
        async with session.get(base + path) as reply:
            text = (await reply.text()).replace("http://www.w3.org/2000/svg", "")
        assert "http:" not in text
        assert "https:" not in text


@pytest.mark.parametrize(
    "path", ["/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/page/../../journal.sqlite", "//etc/passwd"]
)
async def test_no_path_reaches_the_file_system(base: str, path: str) -> None:
    """Whatever the path, only routes of the table are served."""
    host, port = base.removeprefix("http://").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
    head = await reader.read()
    writer.close()
    assert head.split(b"\r\n")[0].split()[1] in (b"404", b"400")
    assert b"root:" not in head


async def test_a_key_that_stands_twice_is_refused(base: str, session: aiohttp.ClientSession) -> None:
    """Which of two levels of a light was meant is not known: nothing is set."""
    body, kind = '{"channel": "white", "level": 0, "level": 1}', {"Content-Type": "application/json"}
    async with session.post(f"{base}/light", data=body, headers=kind) as reply:
        assert (reply.status, "'level' occurs twice" in await reply.text()) == (400, True)


async def test_nonsense_is_refused_without_filling_the_log(base: str) -> None:
    """What is no HTTP gets its 400, and leaves no traceback behind."""
    port, logged = int(base.rsplit(":", 1)[1]), BufferingHandler(100)
    logging.getLogger().addHandler(logged)
    for line in (b"GET /status HT1.1", b"GET /sta\x00tus HTTP/1.1", b"GET http://[ HTTP/1.1"):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(line + b"\r\nHost: localhost\r\n\r\n")
        assert b" 400 " in await reader.readline()
        writer.close()
    logging.getLogger().removeHandler(logged)
    assert [record.getMessage() for record in logged.buffer] == []


async def test_rates_and_connections_are_limited(serve: Any, session: aiohttp.ClientSession) -> None:
    """More than allowed gives 429; one connection too many gives 503."""
    base = await serve(limits=Limits(http_requests_per_s=5.0, http_connections=2))
    statuses = []
    while 429 not in statuses and len(statuses) < 1000:
        async with session.get(f"{base}/healthz") as reply:
            statuses.append(reply.status)
    assert statuses[:5] == [200] * 5
    assert 429 in statuses
    async with session.post(f"{base}/light/off") as reply:
        assert reply.status == 200
    host, port = base.removeprefix("http://").split(":")
    streams = [await asyncio.open_connection(host, int(port)) for _ in range(3)]
    assert b"503" in (await asyncio.wait_for(streams[-1][0].read(), within(20.0))).split(b"\r\n")[0]
    for _, writer in streams:
        writer.close()


async def test_the_end_with_a_silent_client_is_no_error(station: Station) -> None:
    """A connection without a request is ended with the daemon; nothing is reported when its time is over."""
    errors: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: errors.append(context))
    server = HttpServer(station, limits=Limits(head_s=0.2))
    reader, writer = await asyncio.open_connection("127.0.0.1", await server.listen("127.0.0.1", 0))
    await asyncio.sleep(0.05)  # until it is accepted
    await server.close()
    async with asyncio.timeout(within(10.0)):
        assert await reader.read() == b""
    await asyncio.sleep(0.3)
    writer.close()
    assert errors == []


async def test_listeners_are_limited(serve: Any, session: aiohttp.ClientSession, station: Station) -> None:
    """Beyond the limit a stream is refused, and a slot is free again once a listener leaves."""
    base = await serve(limits=Limits(listeners=1))
    async with session.get(f"{base}/readings/stream") as first:
        assert first.status == 200
        async with session.get(f"{base}/readings/stream") as second:
            assert second.status == 503


async def test_the_page_is_part_of_the_package(base: str, session: aiohttp.ClientSession, project_root: Path) -> None:
    """Every file of the page folder is served as it is, the licence of what others wrote among them."""
    page = project_root / "radiometer/daemon/http/page"
    served = []
    for path in [route.path for route in ROUTES if route.method == "GET" and route.public]:
        async with session.get(base + path) as reply:
            served.append(await reply.read())
    for file in (path for path in page.rglob("*") if path.is_file()):
        assert file.read_bytes() in served, file.name
    assert b"MIT License" in (page / "uplot/LICENSE").read_bytes()


@pytest.mark.parametrize("path", [route.path for route in ROUTES if route.method == "GET"])
async def test_head_is_answered_like_get_without_a_body(
    base: str, session: aiohttp.ClientSession, station: Station, path: str
) -> None:
    """Status and content type of GET, no body, also where GET would stream for ever."""
    await station.acquisition.measure()
    (route,) = [entry for entry in ROUTES if (entry.method, entry.path) == ("GET", path)]
    async with asyncio.timeout(within(20)), session.head(base + path) as reply:
        assert (reply.status, reply.content_type) == (200, route.reply)
        assert await reply.read() == b""


@pytest.mark.parametrize("age", ["9" * 30 + "d", "9" * 400 + "d", "999999w", "9999-99-99", "0000-01-01"])
async def test_times_beyond_all_calendars_are_refused(base: str, session: aiohttp.ClientSession, age: str) -> None:
    """An age longer than the calendar, or a time that does not exist, is the client's mistake: 400."""
    for name in ("since", "until"):
        async with session.get(f"{base}/readings", params={name: age}) as reply:
            assert reply.status == 400


async def test_the_table_is_the_whole_range(base: str, session: aiohttp.ClientSession, station: Station) -> None:
    """readings.csv without a limit holds every reading of the range; a limit still limits."""
    for _ in range(8):
        await station.acquisition.measure()
    for form, header in (("csv", 1), ("jsonl", 0)):
        async with session.get(f"{base}/readings?format={form}") as reply:
            assert len((await reply.text()).splitlines()) == 8 + header
            assert ("readings.csv" in reply.headers.get("Content-Disposition", "")) is (form == "csv")
        async with session.get(f"{base}/readings?format={form}&after=6") as reply:
            assert len((await reply.text()).splitlines()) == 2 + header
        async with session.get(f"{base}/readings?format={form}&limit=2") as reply:
            assert len((await reply.text()).splitlines()) == 2 + header
    async with session.get(f"{base}/readings?format=csv&until=1h") as reply:
        assert (await reply.text()).startswith("sequence,time,")
        assert len((await reply.text()).splitlines()) == 1


async def test_without_a_picture_there_is_none(base: str, session: aiohttp.ClientSession) -> None:
    """Before the first measurement: status 404, and what makes one."""
    async with session.get(base + "/frame.png") as reply:
        assert reply.status == 404
        assert "POST /measure makes one" in await reply.text()


async def test_a_moved_patch_leaves_the_picture(base: str, session: aiohttp.ClientSession, station: Station) -> None:
    """The picture shows the whole frame: it is still the latest one while the first reading of the new place is due."""
    await station.acquisition.measure()
    async with session.get(base + "/frame.png") as reply:
        before = await reply.read()
    station.configure(patch=Patch(4, 4, 8, 8))
    assert station.shown.latest is None
    async with session.get(base + "/frame.png") as reply:
        assert (reply.status, await reply.read()) == (200, before)


async def test_a_stream_of_an_unknown_form_is_refused(base: str, session: aiohttp.ClientSession) -> None:
    """With the forms that there are; an Accept header alone chooses lines of JSON."""
    async with session.get(f"{base}/readings/stream?format=xml") as reply:
        assert reply.status == 400
        assert "format must be sse or jsonl, not 'xml'" in await reply.text()
    async with session.head(f"{base}/readings/stream", headers={"Accept": "application/x-ndjson"}) as lines:
        assert lines.content_type == "application/x-ndjson"
    async with session.head(f"{base}/readings/stream") as events:
        assert events.content_type == "text/event-stream"


async def test_a_method_that_a_place_does_not_have_is_refused_with_those_that_it_has(
    base: str, session: aiohttp.ClientSession
) -> None:
    """Status 405 with the header that the standard asks for (RFC 9110, 15.5.6)."""
    async with session.delete(f"{base}/readings") as reply:
        assert reply.status == 405
        assert {name.strip() for name in reply.headers["Allow"].split(",")} >= {"GET", "HEAD"}


async def test_a_port_that_is_taken_is_told(base: str, serve: Any, station: Station) -> None:
    """By its number, as a mistake of who starts the daemon."""
    taken = int(base.rpartition(":")[2])
    with pytest.raises(OutputError, match=f"cannot listen for HTTP on 127.0.0.1:{taken}"):
        await HttpServer(station).listen("127.0.0.1", taken)


@pytest.mark.parametrize(
    "path",
    [
        "/readings?limit=1", "/readings?limit=20000", "/readings?clean", "/readings?clean=on", "/readings?clean=True",
        "/readings?clean=0&after=4611686018427387903", "/trend?points=10", "/trend?points=5000", "/events?limit=1",
        "/events?limit=5000", "/frame.png?width=64", "/frame.png?width=2048",
    ],
)  # fmt: skip
async def test_a_query_is_taken_up_to_its_bounds(
    base: str, session: aiohttp.ClientSession, station: Station, path: str
) -> None:
    """The lowest and the highest number are served, and a boolean in every spelling."""
    await station.acquisition.measure()
    async with session.get(base + path) as reply:
        assert reply.status == 200, await reply.text()


@pytest.mark.parametrize(
    ("accept", "query", "kind"),
    [("*/*", {}, "application/json"), ("text/csv", {}, "text/csv"), ("*/*", {"format": "csv"}, "text/csv"),
     ("application/x-ndjson", {}, "application/x-ndjson"),
     ("text/csv", {"format": "json"}, "application/json"),
     ("*/*", {"format": "jsonl"}, "application/x-ndjson")],
)  # fmt: skip
async def test_the_form_of_a_history_is_asked_for(
    base: str, session: aiohttp.ClientSession, station: Station, accept: str, query: dict[str, str], kind: str
) -> None:
    """By the query, else by the Accept header, else it is JSON; each form holds the same readings."""
    for _ in range(3):
        await station.acquisition.measure()
    async with session.get(f"{base}/readings", params={**query, "limit": "2"}, headers={"Accept": accept}) as reply:
        text = await reply.text()
    assert reply.content_type == kind
    assert (len(json.loads(text)) if kind == "application/json" else text.count("\n") - (kind == "text/csv")) == 2


async def test_health_is_503_while_an_alarm_is_up(base: str, session: aiohttp.ClientSession, station: Station) -> None:
    """What a watchdog looks at: 200 and ok, or 503 and the names."""
    for status, text in ((200, {"status": "ok", "alarms": []}), (503, {"status": "alarm", "alarms": ["disk"]})):
        async with session.get(f"{base}/healthz") as reply:
            assert (reply.status, await reply.json()) == (status, text)
        station.alarms.put_up("disk", "full")


@pytest.mark.parametrize("size", [None, 256, 4096])
async def test_the_curve_of_the_page_is_that_in_use_or_a_straight_line(
    base: str, session: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch, instrument: Any, size: int | None
) -> None:
    """A line is ln M up to a constant that makes half of full scale 0; of a long curve at most 512 points are shown."""
    curve = None if size is None else ResponseCurve(np.linspace(-5.0, 2.0, size), np.full(size, 0.01))
    monkeypatch.setattr(type(instrument), "response", curve)
    async with session.get(f"{base}/response") as reply:
        shown = await reply.json()
    assert (shown["linear"], shown["absolute"]) == (size is None, False)
    dn = np.array(shown["dn"])
    if size is None:
        assert shown["log_exposure"] == pytest.approx(np.log(dn / 2048).tolist())
        assert set(shown["u_log_exposure"]) == {0.0}
    else:
        assert (dn.size, dn[0], dn[-1]) == (min(size, 512), 0, size - 1)
        assert shown["log_exposure"] == pytest.approx((-5.0 + 7.0 * dn / (size - 1)).tolist())
        assert set(shown["u_log_exposure"]) == {0.01}


async def test_a_trend_is_in_seconds_and_with_twice_the_standard_uncertainty(
    base: str, session: aiohttp.ClientSession, station: Station, make_reading: Callable[..., Reading]
) -> None:
    """An hour of 20 November 2026, and one reading of 1 ± 0.01 there: U is 0.02."""
    at = 1_795_132_800  # 2026-11-20T00:00:00Z
    await station.writer.submit(make_reading(time="2026-11-20T00:10:00.000000Z"))
    async with session.get(f"{base}/trend?since=2026-11-20T00:00:00Z&until=2026-11-20T01:00:00Z") as reply:
        shown = await reply.json()
    assert (shown["since"], shown["until"]) == (at, at + 3600)
    assert (shown["value"], shown["U"]) == ([1.0], [0.02])
    assert shown["time"] == [pytest.approx(at + 600, abs=1.8)]  # the middle of a thousandth of the hour, 3.6 s


async def test_a_remark_is_repeated_in_its_own_letters(base: str, session: aiohttp.ClientSession) -> None:
    """Blanks put in order, letters as they are: no client has to undo escapes to read them."""
    async with session.post(f"{base}/events", json={"message": " Lampe  geändert: 3 °C "}) as reply:
        text = await reply.text()
    assert "Lampe geändert: 3 °C" in text
    assert json.loads(text) == {"kind": "remark", "message": "Lampe geändert: 3 °C"}


@pytest.mark.parametrize(("last", "first"), [("3", 4), ("-1", None), ("1e1", None), ("9" * 19, None), ("٣", None)])
async def test_a_stream_goes_on_from_a_number_and_from_nothing_else(
    base: str, session: aiohttp.ClientSession, station: Station, last: str, first: int | None
) -> None:
    """A whole number of ASCII digits that SQLite holds; anything else begins with what comes next."""
    for _ in range(5):
        await station.acquisition.measure()
    headers = {"Last-Event-ID": last.encode().decode("latin-1")}
    async with session.get(f"{base}/readings/stream", headers=headers) as reply:
        await station.acquisition.measure()
        async for line in reply.content:
            if line.startswith(b"id: "):
                assert int(line[4:]) == (first or 6)
                break
