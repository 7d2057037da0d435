"""HTTP: history, stream, picture, settings, description, each rule of access, and who is refused."""

import asyncio
import json
import logging
import re
from logging.handlers import BufferingHandler
from typing import get_args
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from radiometer.daemon.http.server import ROUTES, HttpServer, description
from radiometer.daemon.journal import JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.limits import Limits, is_allowed, is_loopback, parse_networks
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.data import Patch, ResponseCurve
from radiometer.errors import (
    CalibrationError,
    DeviceLost,
    InputError,
    MeasurementError,
    OutputError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)
from testing.patience import within


async def test_measure_replies_the_documented_reading(http, station):
    """POST /measure measures the patch asked for; the reply is the journal's line, and only the asker's."""
    body = {"patch": {"x": 3, "y": 4, "width": 5, "height": 6}}
    reply = await http.post("/measure", json=body)
    reading = reply.json()
    assert reply.status == 200
    (line,) = JournalReader(station.journal_path).lines(ReadingFilter(stream="own"))
    assert reading == json.loads(line)
    assert station.shown.latest is None
    assert (reading["patch"], reading["radiance"]["value"]) == (body["patch"], 4.0)
    assert station.settings.patch is None


async def test_history_filters(http, station):
    """`limit` keeps the newest, `after` begins with the oldest above it."""
    for _ in range(5):
        await station.acquisition.measure()

    async def numbers(query):
        reply = await http.get(f"/readings?{query}")
        return [reading["sequence"] for reading in reply.json()]

    assert await numbers("limit=2") == [4, 5]
    assert await numbers("after=1&limit=2") == [2, 3]
    assert await numbers("until=1h") == []
    assert len(await numbers("since=1h&clean=true")) == 5
    assert await numbers("flag=saturated") == []


# Ages beyond the calendar, and days that it does not have.
_NO_TIMES = ("9" * 30 + "d", "9" * 400 + "d", "999999w", "9999-99-99", "0000-01-01")


async def test_wrong_queries_are_refused_with_the_reason(http):
    """Status 400 and JSON that says what is allowed."""
    for path, message in (
        ("/readings?limit=0", "limit: Input should be greater than or equal to 1"),
        ("/readings?limit=abc", "limit: Input should be a valid integer"),
        ("/readings?since=yesterday", "ISO 8601"),
        ("/readings?format=xml", "format: Input should be 'json', 'jsonl' or 'csv'"),
        ("/readings/stream?format=xml", "format: Input should be 'sse' or 'jsonl'"),
        ("/readings?nonsense=1", "nonsense: Extra inputs are not permitted; allowed are since, until"),
        *((f"/readings?{end}={age}", "ISO 8601") for end in ("since", "until") for age in _NO_TIMES),
        ("/readings?limit=20001", "limit must be 1 to 20000"),
        ("/readings?clean=maybe", "clean"),
        ("/readings?stream=lamp", "stream"),
        ("/readings?after=9223372036854775808", "after"),
        ("/trend?points=9", "points: Input should be greater than or equal to 10"),
        ("/trend?points=5001", "points: Input should be less than or equal to 5000"),
        ("/events?limit=0", "limit: Input should be greater than or equal to 1"),
        ("/events?limit=5001", "limit: Input should be less than or equal to 5000"),
        ("/frame.png?width=63", "width: Input should be greater than or equal to 64"),
        ("/frame.png?width=2049", "width: Input should be less than or equal to 2048"),
    ):
        reply = await http.get(path)
        assert reply.status == 400, path
        assert message in reply.json()["error"]["message"], path


async def test_wrong_bodies_are_refused_and_change_nothing(http, station):
    """Out of range, unknown, malformed or too large."""
    for body, status in (
        (b'{"patch": {"x": 1}}', 400),
        (b'{"patch": {"x": 1.5, "y": 2, "width": 3, "height": 4}}', 400),
        (b'{"nonsense": 1}', 400),
        (b'{"gain_db": 1, "gain_db": 2}', 400),  # which was meant is not known
        (b"{", 400),
        (b'{"patch": {"x": 60, "y": 0, "width": 10, "height": 10}}', 400),
        (b'{"exposure_s": 1e9}', 400),
        (b'{"gain_db": -1}', 400),
        (b"x" * 16_385, 413),  # one byte over 16 KiB
    ):
        before = station.settings
        for path in ("/measure", "/settings"):
            reply = await http.post(path, data=body, headers={"Content-Type": "application/json"})
            assert reply.status == status, reply.text
        assert station.settings == before, body
        assert station.shown.latest is None, body


def _numbers(model):
    """Return the fields of a body that take numbers and no text, with those of its parts, as the body's keys."""
    found = {}
    for name, field in model.model_fields.items():
        kinds = get_args(field.annotation) or (field.annotation,)
        parts = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
        found |= {f"{name}.{key}": kind for part in parts for key, kind in _numbers(part).items()}
        found |= {name: field.annotation} if {int, float} & set(kinds) else {}
    return found


async def test_what_is_no_number_is_refused_in_every_body(serve):
    """Text, truth values and lists in place of each number of each request: 400, and the key is named."""
    http = await serve(limits=Limits(http_requests_per_s=1e4))
    for wrong in ("0.5", "1", "NaN", "", True, False, [1], {"value": 1}):
        for path, key in ((one.path, key) for one in ROUTES if one.body is not None for key in _numbers(one.body)):
            outer, _, inner = key.partition(".")
            reply = await http.post(path, json={outer: {inner: wrong} if inner else wrong})
            assert reply.status == 400, (path, key, wrong)
            assert any(word in reply.text for word in ("number", "integer", "Field required")), (path, key, wrong)


async def test_the_stream_replays_and_follows_without_gap(http, station):
    """A client that reconnects with Last-Event-ID gets every reading once, in order."""
    station.set_every(0.005)
    while station.shown.latest is None or station.shown.latest.sequence < 10:
        await asyncio.sleep(0.01)
    numbers = []
    async with http.session.get("/readings/stream", headers={"Last-Event-ID": "3"}) as reply:
        assert reply.content_type == "text/event-stream"
        async for raw in reply.content:
            if raw.startswith(b"data: ") and b'"radiance"' in raw:
                numbers.append(json.loads(raw[6:])["sequence"])
            if len(numbers) == 40:
                break
    assert numbers == list(range(4, 44))


async def test_a_number_of_another_journal_gets_all_of_this_one(http, station):
    """After a new journal was begun, clients and pollers ask after numbers that it does not have; the header counts."""
    for _ in range(2):
        await station.acquisition.measure()
    reply = await http.get("/readings", params={"after": "100000"})
    assert [one["sequence"] for one in reply.json()] == [1, 2]
    asked = {"params": {"format": "jsonl", "after": "1"}, "headers": {"Last-Event-ID": "100000"}}
    async with http.session.get("/readings/stream", **asked) as stream:
        line = await asyncio.wait_for(stream.content.readline(), within(20.0))
    assert json.loads(line)["sequence"] == 1


async def test_metrics_hold_what_an_operator_watches(http, station, eventually):
    """Readings, latency, exposure, lost packets, retries, temperature, queue depth."""
    await station.acquisition.measure()
    await eventually(lambda: station.camera.report.counters.get("frames"))
    station.alarms.put_up("lens", "dusty")
    text = (await http.get("/metrics")).text
    for line in (
        'radiometer_device_up{device="camera"} 1.0',
        'radiometer_device_up{device="light box"} 1.0',
        'radiometer_temperature_celsius{device="light box"} 30.0',
        "radiometer_alarms 1.0",
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


async def test_settings_change_and_are_reported(http, station, box):
    """What is left out stays; an exposure switches automatic exposure off; null stops continuous measurement."""
    status = (await http.post("/settings", json={"exposure_s": 0.02, "every_s": 5})).json()
    assert (status["settings"]["auto_exposure"], status["every_s"]) == (False, 5.0)
    status = (await http.post("/settings", json={"every_s": None})).json()
    assert (status["settings"]["exposure_s"], status["every_s"]) == (0.02, None)
    reply = await http.post("/light", json={"channel": "red", "level": 0.25})
    assert (reply.status, box.levels["red"]) == (200, 0.25)
    reply = await http.post("/light", json={"channel": "blue", "level": 0.25})
    assert reply.status == 400


async def test_the_description_covers_every_route(http):
    """OpenAPI lists each path and method that is served, every reference resolves, and it is served itself."""
    served = (await http.get("/openapi.json")).json()
    assert served == json.loads(json.dumps(description(ROUTES)))
    assert {(path, method) for path, entry in served["paths"].items() for method in entry} == {
        (route.path, route.method.lower()) for route in ROUTES
    }
    references = {part.split('"')[0] for part in json.dumps(served).split("#/components/schemas/")[1:]}
    assert references <= set(served["components"]["schemas"])


async def test_no_path_reaches_the_file_system(http):
    """Whatever the path, only routes of the table are served."""
    for path in ("/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/page/../../journal.sqlite", "//etc/passwd"):
        reader, writer = await asyncio.open_connection("127.0.0.1", http.port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        head = await reader.read()
        writer.close()
        assert head.split(b"\r\n")[0].split()[1] in (b"404", b"400"), path
        assert b"root:" not in head, path


async def test_nonsense_is_refused_without_filling_the_log(http):
    """What is no HTTP gets its 400, and leaves no traceback behind."""
    logged = BufferingHandler(100)
    logging.getLogger().addHandler(logged)
    for line in (b"GET /status HT1.1", b"GET /sta\x00tus HTTP/1.1", b"GET http://[ HTTP/1.1"):
        reader, writer = await asyncio.open_connection("127.0.0.1", http.port)
        writer.write(line + b"\r\nHost: localhost\r\n\r\n")
        assert b" 400 " in await reader.readline()
        writer.close()
    logging.getLogger().removeHandler(logged)
    assert [record.getMessage() for record in logged.buffer] == []


async def test_rates_and_connections_are_limited(serve):
    """More than allowed gives 429; one connection too many gives 503."""
    http = await serve(limits=Limits(http_requests_per_s=5.0, http_connections=2))
    statuses = []
    while 429 not in statuses and len(statuses) < 1000:
        statuses.append((await http.get("/healthz")).status)
    assert statuses[:5] == [200] * 5
    assert 429 in statuses
    assert (await http.post("/light/off")).status == 200
    streams = [await asyncio.open_connection("127.0.0.1", http.port) for _ in range(3)]
    assert b"503" in (await asyncio.wait_for(streams[-1][0].read(), within(20.0))).split(b"\r\n")[0]
    for _, writer in streams:
        writer.close()


async def test_the_end_with_a_silent_client_is_no_error(station):
    """A connection without a request is ended with the daemon; nothing is reported when its time is over."""
    errors = []
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


@pytest.mark.parametrize("asked", [{"params": {"format": "jsonl"}}, {"headers": {"Accept": "application/x-ndjson"}}])
async def test_listeners_are_limited(serve, station, asked):
    """Beyond the limit a stream is refused; whether query or Accept header asks for lines, each is a reading."""
    http = await serve(limits=Limits(listeners=1))
    await station.acquisition.measure()
    async with http.session.get("/readings/stream?after=0", **asked) as first:
        line = await asyncio.wait_for(first.content.readline(), within(20.0))
        assert (await http.get("/readings/stream")).status == 503
    assert json.loads(line) == station.shown.latest.to_mapping()


async def test_the_page_is_part_of_the_package(http, project_root):
    """Every file of the page folder is served as it is, licences too; none of ours names another host."""
    page = project_root / "radiometer/daemon/http/page"
    served = [(await http.get(route.path)).body for route in ROUTES if route.method == "GET" and route.public]
    for file in (path for path in page.rglob("*") if path.is_file()):
        content = file.read_bytes()
        assert content in served, file.name
        outside = re.findall(rb"https?:", content.replace(b"http://www.w3.org/2000/svg", b""))
        assert outside == [] or file.parent.name == "uplot", file.name
    assert b"MIT License" in (page / "uplot/LICENSE").read_bytes()


async def test_every_get_route_answers_and_head_like_it_without_a_body(http, station):
    """Status 200, the content type that the table says, security headers; HEAD has no body, and an end."""
    await station.acquisition.measure()
    for route in (route for route in ROUTES if route.method == "GET"):
        async with asyncio.timeout(within(20)):
            reply = await http.head(route.path)
        assert (reply.status, reply.content_type, reply.body) == (200, route.reply, b"")
        if "stream" not in route.path:
            reply = await http.get(route.path)
            assert (reply.status, reply.content_type) == (200, route.reply)
            assert "default-src 'none'" in reply.headers["Content-Security-Policy"], route


async def test_the_table_is_the_whole_range(http, station):
    """readings.csv without a limit holds every reading of the range; a limit still limits."""
    for _ in range(8):
        await station.acquisition.measure()
    for form, header in (("csv", 1), ("jsonl", 0)):
        reply = await http.get(f"/readings?format={form}")
        assert len(reply.text.splitlines()) == 8 + header
        assert ("readings.csv" in reply.headers.get("Content-Disposition", "")) is (form == "csv")
        reply = await http.get(f"/readings?format={form}&limit=2")
        assert len(reply.text.splitlines()) == 2 + header
    reply = await http.get("/readings?format=csv&until=1h")
    assert reply.text.startswith("sequence,time,")
    assert len(reply.text.splitlines()) == 1


async def test_a_moved_patch_leaves_the_picture(http, station):
    """It shows the whole frame, also while the first of the new place is due; before any there is none (404)."""
    reply = await http.get("/frame.png")
    assert (reply.status, "POST /measure makes one" in reply.text) == (404, True)
    await station.acquisition.measure()
    reply = await http.get("/frame.png")
    before = reply.body
    station.configure(patch=Patch(4, 4, 8, 8))
    assert station.shown.latest is None
    reply = await http.get("/frame.png")
    assert (reply.status, reply.body) == (200, before)


async def test_a_method_that_a_place_does_not_have_is_refused_with_those_that_it_has(http):
    """Status 405 with the header that the standard asks for (RFC 9110, 15.5.6)."""
    reply = await http.delete("/readings")
    assert reply.status == 405
    assert {name.strip() for name in reply.headers["Allow"].split(",")} >= {"GET", "HEAD"}


async def test_a_port_that_is_taken_is_told(http, station):
    """By its number, as a mistake of who starts the daemon."""
    with pytest.raises(OutputError, match=f"cannot listen for HTTP on 127.0.0.1:{http.port}"):
        await HttpServer(station).listen("127.0.0.1", http.port)


async def test_a_query_is_taken_up_to_its_bounds(http, station):
    """The lowest and the highest number are served, and a boolean in every spelling."""
    await station.acquisition.measure()
    for path in (
        "/readings?limit=1", "/readings?limit=20000", "/readings?clean", "/readings?clean=on", "/readings?clean=True",
        "/readings?clean=0&after=4611686018427387903", "/trend?points=10", "/trend?points=5000", "/events?limit=1",
        "/events?limit=5000", "/frame.png?width=64", "/frame.png?width=2048",
    ):  # fmt: skip
        reply = await http.get(path)
        assert reply.status == 200, reply.text


async def test_the_form_of_a_history_is_asked_for(http, station):
    """By the query, else by the Accept header, else it is JSON; each form holds the same readings."""
    for _ in range(3):
        await station.acquisition.measure()
    for accept, query, kind in (
        ("*/*", {}, "application/json"), ("text/csv", {}, "text/csv"), ("*/*", {"format": "csv"}, "text/csv"),
        ("application/x-ndjson", {}, "application/x-ndjson"), ("text/csv", {"format": "json"}, "application/json"),
        ("*/*", {"format": "jsonl"}, "application/x-ndjson"),
    ):  # fmt: skip
        reply = await http.get("/readings", params={**query, "limit": "2"}, headers={"Accept": accept})
        assert reply.content_type == kind, (accept, query)
        rows = reply.json() if kind == "application/json" else reply.text.splitlines()[kind == "text/csv" :]
        assert len(rows) == 2, (accept, query)


@pytest.mark.parametrize("size", [None, 256, 4096])
async def test_the_curve_of_the_page_is_that_in_use_or_a_straight_line(http, monkeypatch, instrument, size):
    """A line is ln M up to a constant that makes half of full scale 0; of a long curve at most 512 points are shown."""
    curve = None if size is None else ResponseCurve(np.linspace(-5.0, 2.0, size), np.full(size, 0.01))
    monkeypatch.setattr(type(instrument), "response", curve)
    shown = (await http.get("/response")).json()
    assert (shown["linear"], shown["absolute"]) == (size is None, False)
    dn = np.array(shown["dn"])
    if size is None:
        assert shown["log_exposure"] == pytest.approx(np.log(dn / 2048).tolist())
        assert set(shown["u_log_exposure"]) == {0.0}
    else:
        assert (dn.size, dn[0], dn[-1]) == (min(size, 512), 0, size - 1)
        assert shown["log_exposure"] == pytest.approx((-5.0 + 7.0 * dn / (size - 1)).tolist())
        assert set(shown["u_log_exposure"]) == {0.01}


async def test_a_trend_is_in_seconds_and_with_twice_the_standard_uncertainty(http, station, make_reading):
    """An hour of 20 November 2026, and one reading of 1 ± 0.01 there: U is 0.02."""
    at = 1_795_132_800  # 2026-11-20T00:00:00Z
    await station.writer.submit(make_reading(time="2026-11-20T00:10:00.000000Z"))
    shown = (await http.get("/trend?since=2026-11-20T00:00:00Z&until=2026-11-20T01:00:00Z")).json()
    assert (shown["since"], shown["until"]) == (at, at + 3600)
    assert (shown["value"], shown["U"]) == ([1.0], [0.02])
    assert shown["time"] == [pytest.approx(at + 600, abs=1.8)]  # the middle of a thousandth of the hour, 3.6 s


async def test_a_remark_is_repeated_in_its_own_letters(http):
    """Blanks put in order, letters as they are: no client has to undo escapes to read them."""
    text = (await http.post("/events", json={"message": " Lampe  geändert: 3 °C "})).text
    assert "Lampe geändert: 3 °C" in text
    assert json.loads(text) == {"kind": "remark", "message": "Lampe geändert: 3 °C"}


@pytest.mark.parametrize(("last", "first"), [("3", 4), ("-1", None), ("1e1", None), ("9" * 19, None), ("٣", None)])
async def test_a_stream_goes_on_from_a_number_and_from_nothing_else(http, station, last, first):
    """A whole number of ASCII digits that SQLite holds; anything else begins with what comes next."""
    for _ in range(5):
        await station.acquisition.measure()
    headers = {"Last-Event-ID": last.encode().decode("latin-1")}
    async with http.session.get("/readings/stream", headers=headers) as reply:
        await station.acquisition.measure()
        async for line in reply.content:
            if line.startswith(b"id: "):
                assert int(line[4:]) == (first or 6)
                break


# Each rule of HTTP access on both sides of it: host, origin, token, rate, and what an error is called.


# Of the OWASP secure-headers list, what keeps a page from being framed, guessed at, or shown to other sites.
HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-store"}
octets = st.integers(0, 255)


def test_a_token_of_what_cannot_be_seen_is_refused(station):
    """Zero bytes, blanks, marks of no width, private and half characters, alone or at the end of a good token."""
    for sign in ("\0", "\t", " ", "\u00a0", "\u200b", "\u202e", "\ufeff", "\ue000", "\ud800"):
        for visible in ("", "a-token-so-long-as-it"):
            with pytest.raises(UsageError, match=r"invisible characters.*openssl"):
                HttpServer(station, token=visible + sign * 20)


async def test_a_token_of_any_bytes_is_refused_without_an_error(serve):
    """What is no UTF-8 is a wrong token like any other: 401; in UTF-8 it opens."""
    http = await serve(token="schlüssel-zum-haus")

    async def status(header):
        reader, writer = await asyncio.open_connection("127.0.0.1", http.port)
        head = b"GET /status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: "
        writer.write(head + header + b"\r\n\r\n")
        async with asyncio.timeout(within(10.0)):
            reply = await reader.read()
        writer.close()
        return reply.split(b" ", 2)[1]

    for sent in (b"Bearer \xff\xfe", b"Bearer \xed\xa0\x80", "Bearer schlüssel-zum-haus".encode("latin-1")):
        assert await status(sent) == b"401", sent
    assert await status("Bearer schlüssel-zum-haus".encode()) == b"200"


async def test_only_pages_of_this_host_and_origin_may_change_anything(http):
    """Scheme aside, host and port must be those asked; no header at all is no browser."""
    for headers, status in (
        ({}, 200), ({"Host": "localhost:PORT"}, 200), ({"Host": "LOCALHOST:PORT"}, 200), ({"Host": "[::1]:80"}, 200),
        ({"Host": "evil.example:PORT"}, 403), ({"Host": "127.0.0.1.evil.example"}, 403),
        ({"Host": "localhost@evil.example"}, 403), ({"Origin": "http://127.0.0.1:PORT"}, 200),
        ({"Origin": "HTTP://127.0.0.1:PORT"}, 200), ({"Origin": "http://127.0.0.1:1"}, 403),
        ({"Origin": "http://127.0.0.1"}, 403), ({"Origin": "null"}, 403), ({"Origin": "http://[::1"}, 403),
        ({"Origin": "http://127.0.0.1:PORT.evil.example"}, 403), ({"Sec-Fetch-Site": "same-origin"}, 200),
        ({"Sec-Fetch-Site": "none"}, 200), ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Origin": "http://127.0.0.1:PORT"}, 403),
        ({"Content-Type": "text/plain"}, 415),
    ):  # fmt: skip
        sent = {name: value.replace("PORT", str(http.port)) for name, value in headers.items()}
        assert (await http.post("/events", json={"message": "x"}, headers=sent)).status == status


@given(octets, octets, octets, octets, st.integers(0, 32))
def test_a_network_holds_the_addresses_that_share_its_bits(a, b, c, d, prefix):
    """Address by address, mapped into IPv6 too, by shifting instead of a library."""
    networks = parse_networks([f"{a}.{b}.{c}.{d}/{prefix}"])
    bits = a << 24 | b << 16 | c << 8 | d
    for flipped in (0, 1 << 31, 1 << 24, 1 << 16, 1 << 8, 1):
        other = bits ^ flipped
        inside = (other >> (32 - prefix)) == (bits >> (32 - prefix)) or other >> 24 == 127
        text = ".".join(str(other >> shift & 255) for shift in (24, 16, 8, 0))
        assert is_allowed(text, networks) is inside
        assert is_allowed(f"::ffff:{text}", networks) is inside


async def test_only_loopback_may_be_open_without_a_token(station):
    """Every other address is refused with the way out before anything listens."""
    for address, loopback in (
        ("127.0.0.1", True), ("127.8.9.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),
        ("192.168.1.1", False), ("10.0.0.1", False), ("", False), ("example", False),
    ):  # fmt: skip
        assert is_loopback(address) is loopback, address
        if not loopback:
            server = HttpServer(station)
            with pytest.raises(UsageError, match="--token-file"):
                await server.listen(address, 0)
            await server.close()


async def test_every_reply_carries_the_headers_that_keep_the_page_whole(http):
    """Success, error and refusal alike; what is refused is JSON that says why."""
    for path, headers, status in (
        ("/status", {}, 200), ("/nothing", {}, 404), ("/status", {"Host": "evil.example"}, 403),
        ("/readings?limit=x", {}, 400),
    ):  # fmt: skip
        reply = await http.get(path, headers=headers)
        assert reply.status == status
        assert {name: reply.headers.get(name) for name in HEADERS} == HEADERS
        policy = reply.headers["Content-Security-Policy"]
        assert {"default-src 'none'", "script-src 'self'", "frame-ancestors 'none'"} <= set(policy.split("; "))
        if status != 200:
            assert reply.json()["error"]["status"] == status


async def test_what_a_measurement_ends_in_is_reported_as_json(http, station, monkeypatch):
    """Our own errors in their words, a bug without them; with the headers of every reply, and the next is served."""
    out = SettingOutOfRange("c", "gain", 1.0, 0.0, 0.5, "dB")
    for error, status, message in (
        (KeyError("secret"), 500, "unexpected error; the daemon's log has the particulars"),
        (TimeoutError(), 504, "no reading within the deadline"), (TimeoutError("late"), 504, "late"),
        (DeviceLost("gone"), 503, "gone"), (MeasurementError("dark"), 422, "dark"), (UsageError('"×"'), 400, '"×"'),
        *((kind("x"), 400, "x") for kind in (UnsafeStimulus, InputError, CalibrationError)), (out, 400, str(out)),
        (JournalError("x"), 503, "x"),
    ):  # fmt: skip
        monkeypatch.setattr(station.acquisition, "measure", mock.AsyncMock(side_effect=error))
        reply = await http.post("/measure", json={})
        assert (reply.status, reply.json()) == (status, {"error": {"status": status, "message": message}}), status
        assert {name: reply.headers.get(name) for name in HEADERS} == HEADERS, status
        assert (await http.get("/status")).status == 200, status


async def test_who_is_connected_when_the_server_closes_is_hung_up_on(station):
    """A connection that is kept alive ends at once, however long it might stay; new ones are refused."""
    server = HttpServer(station)
    port = await server.listen("127.0.0.1", 0)
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert (await reader.readuntil(b"\r\n")).startswith(b"HTTP/1.1 200")
    await server.close()
    async with asyncio.timeout(within(10.0)):
        await reader.read()
    writer.close()
    with pytest.raises(ConnectionError):
        await asyncio.open_connection("127.0.0.1", port)


TOKEN = "a-token-of-some-length"


def test_the_allow_list_lets_in_whom_it_names(station):
    """Loopback always, members of a network, no one else; without a list no one but loopback."""
    for peer, allowed in (
        ("127.0.0.1", True), ("::1", True), ("::ffff:127.0.0.1", True),
        ("192.168.1.7", True), ("192.168.2.7", False), ("10.0.0.7", True), ("10.0.0.8", False),
        ("::ffff:192.168.1.7", True), ("::ffff:192.168.2.7", False), ("fd00::1", True), ("fe00::1", False),
        ("fd00::5%eth0", True), ("fe80::1%eth0", False),
        ("8.8.8.8", False), ("", False), ("nonsense", False), ("192.168.1.7.evil.example", False),
    ):  # fmt: skip
        networks = parse_networks(["192.168.1.0/24", "10.0.0.7", "fd00::/8"])
        assert is_allowed(peer, networks) is allowed, peer
        assert is_allowed(peer, ()) is (peer in ("127.0.0.1", "::1", "::ffff:127.0.0.1")), peer
        server = ScpiServer(station, allow=networks)
        assert bool(server.refusal((peer, 5025))) is not allowed, peer
        assert bool(ScpiServer(station).refusal((peer, 5025))) is not is_allowed(peer, ()), peer


async def test_without_the_token_nothing_but_the_public_is_served(serve, station):
    """Every route that is not public needs the whole token, after Bearer in any case; public ones tell nothing."""
    http = await serve(token=TOKEN, limits=Limits(http_requests_per_s=1e4))
    public = {route.path for route in ROUTES if route.public}
    assert not public & {"/readings", "/readings/stream", "/measure", "/settings", "/light", "/light/off", "/status",
                         "/trend", "/patches", "/patches/delete", "/events", "/frame.png", "/metrics"}  # fmt: skip
    wrong = ("", TOKEN, f"Basic {TOKEN}", *(f"Bearer {one}" for one in ("", TOKEN[:-1], f"{TOKEN}x", TOKEN.title())))
    for route in ROUTES:
        for stated in (None, *wrong):
            headers = {"Host": "radiometer.lab"} | ({} if stated is None else {"Authorization": stated})
            async with http.session.request(route.method, route.path, headers=headers) as reply:
                assert (reply.status == 401) is (not route.public), (route.path, stated)
    assert station.shown.latest is None
    for word in ("Bearer ", "bearer  ", "BEARER "):
        assert (await http.get("/status", headers={"Authorization": word + TOKEN})).status == 200
