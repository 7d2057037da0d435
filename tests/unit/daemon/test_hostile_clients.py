"""Clients that take no replies, drip their requests or never read: what they hold is bounded, and others are served."""

import asyncio
import contextlib
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest

from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.limits import Limits, Places, ReplyBudget
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Hub
from radiometer.errors import UsageError
from testing.fake_station import HttpClient
from testing.patience import within

_LIMITS = Limits(http_connections=12, listeners=4, listening_s=0.0, http_requests_per_s=1e4)


@pytest.fixture
async def http(serve):
    """Return a client of an HTTP server with few places."""
    return await serve(limits=_LIMITS)


async def _open(http, text):
    _, writer = await asyncio.open_connection("127.0.0.1", http.port)
    writer.write(text.encode())
    await writer.drain()
    return writer


_HEADS = {
    "half a body": "POST /measure HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    "Content-Length: 9\r\n\r\n{",
    "half a head": "GET /status HTTP/1.1\r\nHost: local",
}


@pytest.mark.parametrize("head", _HEADS.values(), ids=_HEADS)
async def test_clients_that_drip_their_requests_do_not_lock_others_out(http, head):
    """More of them than there are places, again and again: every honest request is answered."""
    writers = []
    for _ in range(6):
        writers += [await _open(http, head) for _ in range(2 * _LIMITS.http_connections)]
        async with asyncio.timeout(within(10.0)):
            assert (await http.get("/healthz", headers={"Connection": "close"})).status == 200
    for writer in writers:
        writer.close()


async def test_lights_go_off_while_busy_clients_hold_every_place(http):
    """Each keeps its connection and asks three times a second; one that waits between two requests makes room."""
    head = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
    writers = [await _open(http, head) for _ in range(_LIMITS.http_connections)]

    async def poll():
        while True:
            await asyncio.sleep(0.3)
            for writer in writers:
                with suppress(OSError):
                    writer.write(head.encode())

    polling = asyncio.create_task(poll())
    replies = list[str]()
    async with asyncio.timeout(within(10.0)):
        while not any("alarms" in one for one in replies):  # a refusal has no body
            await asyncio.sleep(0.07)
            replies.append((await http.get("/healthz", headers={"Connection": "close"})).text)
    assert "alarms" in replies[-1]
    polling.cancel()
    for writer in writers:
        writer.close()


async def test_listeners_that_do_not_read_do_not_hold_all_streams(http, station):
    """As many as there are streams and more: a newcomer is served, and a reading reaches it."""
    head = "GET /readings/stream HTTP/1.1\r\nHost: localhost\r\n\r\n"
    writers = [await _open(http, head) for _ in range(_LIMITS.listeners + 1)]
    lines = {"format": "jsonl"}
    async with asyncio.timeout(within(10.0)), http.session.get("/readings/stream", params=lines) as stream:
        assert stream.status == 200
        await station.acquisition.measure()
        assert b"radiance" in await stream.content.readline()
    for writer in writers:
        writer.close()


async def test_listeners_that_do_not_read_hold_little_however_long_the_journal_is(http, station):
    """Four that ask for 400 readings of some 1.6 kB and take none hold less than a fifth of them."""
    for _ in range(400):
        await station.acquisition.measure()
    tracemalloc.start()
    try:
        head = "GET /readings/stream?after=0 HTTP/1.1\r\nHost: localhost\r\n\r\n"
        writers = [await _open(http, head) for _ in range(_LIMITS.listeners)]
        for writer in writers:
            writer.transport.pause_reading()
        await asyncio.sleep(1.0)
        held_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert held_bytes < 0.2 * 4 * 400 * 1600 + 500_000
    for writer in writers:
        writer.transport.abort()


async def test_the_stream_that_is_furthest_behind_ends_first():
    """Then the oldest; none that is younger than asked for."""
    now = [0.0]
    hub = Hub(lambda: now[0])
    oldest, behind = hub.subscribe(), hub.subscribe()
    behind.offer(Any)
    assert not hub.end_one(1.0)
    now[0] = 2.0
    newest = hub.subscribe()
    assert hub.end_one(1.0)
    assert (oldest.closed, behind.closed) == (False, True)
    assert hub.end_one(1.0)
    assert (oldest.closed, newest.closed) == (True, False)
    assert not hub.end_one(1.0)


async def test_one_message_has_bounded_replies(client, instrument, station):
    """Those without the largest: of 370 pictures of 2 MB two come, and an entry of the queue refuses the rest."""
    instrument.shape = (1024, 1024)
    await station.acquisition.measure()
    async with asyncio.timeout(within(30.0)):
        await client.send(";".join(["TRAC? IMAG"] * 370))
        received = await client.reader.readexactly(2 * (9 + 2_097_152) + 2)
        assert received.endswith(b"\n")
        assert (await client.ask("SYST:ERR?")).startswith('-225,"Out of memory')


def test_all_clients_together_hold_a_bounded_amount():
    """By the budget that they share: small replies always pass, and so does a single one of any size."""
    budget = ReplyBudget(10_000_000)
    assert budget.take(302_000_000)
    assert not budget.take(2_000_000)
    assert all(budget.take(1_000_000) for _ in range(1000))
    for _ in range(1000):
        budget.give_back(1_000_000)
    budget.give_back(302_000_000)
    assert [budget.take(4_000_000) for _ in range(4)] == [True, True, False, False]


async def test_a_client_that_takes_nothing_holds_memory_only_while_it_is_there(instrument, station):
    """It holds the budget; another's picture fails with -225 and its small queries do not; then it is gone."""
    limits = replace(Limits(), large_replies_bytes=3_000_000, reply_bytes_waiting=1000)
    instrument.shape = (6000, 1024)
    await station.acquisition.measure()
    server = ScpiServer(station, limits=limits)
    port = await server.listen_tcp("127.0.0.1", 0)
    lazy = await asyncio.open_connection("127.0.0.1", port, limit=2)
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**24)
    async with asyncio.timeout(within(30.0)):
        lazy[1].write(b"TRAC? IMAG\n")
        while not server.budget.held_bytes:
            await asyncio.sleep(0.01)
        writer.write(b"TRAC? IMAG\nSYST:ERR?\n")
        assert (await reader.readline()).startswith(b'-225,"Out of memory')
        lazy[1].transport.abort()
        while server.budget.held_bytes:
            await asyncio.sleep(0.01)
        writer.write(b"TRAC? IMAG\n")
        assert (await reader.readexactly(10)) == b"#812288000"
    writer.close()
    await server.close()


@pytest.mark.parametrize("token", ["1", "x" * 15, ""])
def test_a_short_token_is_refused_wherever_it_comes_from(station, token):
    """By the server itself, so that file, environment and Python are alike."""
    with pytest.raises(UsageError, match="use 16 or more"):
        HttpServer(station, token=token)


# Slow, idle and noisy clients lock no client out.


@pytest.fixture
async def opened():
    """Return an opener of raw connections that are closed at the end."""
    streams = []

    async def open_one(port):
        streams.append(await asyncio.open_connection("127.0.0.1", port))
        return streams[-1]

    yield open_one
    for _, writer in streams:
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


def _made(limit, now):
    return Places(limit, patience_s=1.0, idle_s=2.0, clock=lambda: now[0])


def test_the_silent_go_first_then_the_longest_idle():
    """A stranger after its patience, then the known one that has been idle longest; the busy stay."""
    now = [0.0]
    places = _made(4, now)
    for name in ("busy", "idle", "idler", "silent"):
        places.enter(name, "127.0.0.1")
    for name in ("idler", "idle"):
        places.note(name, busy=False)
        now[0] += 0.1
    places.note("busy", busy=True)
    assert (places.is_full, places.make_room("127.0.0.1")) == (True, None)
    now[0] = 1.0
    assert places.make_room("127.0.0.1") == "silent"
    places.leave("silent")
    assert places.make_room("127.0.0.1") is None
    places.enter("new", "127.0.0.1")
    places.note("new", busy=True)
    now[0] = 3.0
    assert places.make_room("127.0.0.1") == "idler"
    places.leave("idler")
    places.leave("idle")
    for name in ("c", "d"):
        places.enter(name, "127.0.0.1")
        places.note(name, busy=True)
    now[0] = 99.0
    assert places.make_room("127.0.0.1") is None


def test_a_crowd_of_silent_ones_makes_room_at_once():
    """So many at a time are no accident: their patience is not waited for."""
    now = [0.0]
    places = _made(16, now)
    for number in range(16):
        places.enter(str(number), "127.0.0.1")
        now[0] += 0.001
    assert places.make_room("127.0.0.1") == "0"


def test_one_address_beyond_loopback_has_a_quarter():
    """Others find room; loopback is one address for all of this machine and has no such limit."""
    now = [0.0]
    places = _made(8, now)
    for name in ("a", "b"):
        places.enter(name, "10.0.0.1")
    assert places.refusal("10.0.0.1") != ""
    assert places.refusal("10.0.0.2") == ""
    for name in "cdefg":
        places.enter(name, "127.0.0.1")
    assert places.refusal("127.0.0.1") == ""
    places.note("a", busy=True)
    now[0] = 1.5
    assert places.make_room("10.0.0.1") == "b"  # one of its own, which has made no sense for a second
    places.note("b", busy=True)
    assert places.make_room("10.0.0.1") is None


async def test_a_request_head_has_a_deadline(serve, opened):
    """A connection that sends its head drop by drop is ended; one that has made a request may stay."""
    http = await serve(limits=Limits(head_s=within(0.3)))
    reader, writer = await opened(http.port)
    good_reader, good = await opened(http.port)
    writer.write(b"GET /status HT")
    good.write(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
    async with asyncio.timeout(within(20)):
        assert (await good_reader.readline()).split()[1] == b"200"
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
    good.write(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
    async with asyncio.timeout(within(20)):
        await good_reader.readuntil(b"HTTP/1.1 200")


async def test_a_noisy_connection_does_not_take_the_others_rate(serve):
    """One client runs into its rate; another one of the same address is served all the time."""
    noisy = await serve(limits=Limits(http_requests_per_s=20.0))
    calm = HttpClient(noisy.port)

    async def statuses(client, count):
        return [(await client.get("/healthz")).status for _ in range(count)]

    async with calm.session:
        assert 429 in await statuses(noisy, 400)
        assert await statuses(calm, 5) == [200] * 5
        assert 429 in await statuses(noisy, 100)
