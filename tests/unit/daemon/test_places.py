"""Slow, idle and noisy clients lock no client out."""

import asyncio
import contextlib

import pytest

from radiometer.daemon.limits import Limits
from radiometer.daemon.places import Places
from testing.fake_station import HttpClient
from testing.patience import within


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


async def test_half_open_connections_lock_no_client_out_of_http(http, opened):
    """140 sockets that never finish their request: the next client is served at once."""
    for _ in range(140):
        _, writer = await opened(http.port)
        writer.write(b"GET /status HTTP/1.1\r\nHost: local")
    async with asyncio.timeout(within(20)):
        assert [(await http.get("/status")).status for _ in range(3)] == [200] * 3


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


@pytest.mark.slow
async def test_noisy_new_connections_wait_and_others_get_their_turn(serve):
    """A client that opens a connection per request is slowed down, not given an allowance each time."""
    http = await serve(limits=Limits(http_requests_per_s=20.0))
    begun = asyncio.get_running_loop().time()
    async with asyncio.timeout(within(30)):
        for _ in range(40):
            client = HttpClient(http.port)
            async with client.session:
                assert (await client.get("/healthz")).status == 200
    assert asyncio.get_running_loop().time() - begun > 0.9  # 20 at once, 20 more at 20 per second
