"""Clients that take no replies, drip their requests or never read: what they hold is bounded, and others are served."""

import asyncio
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest

from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.hub import Hub
from radiometer.daemon.limits import Limits, ReplyBudget
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.errors import UsageError
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


async def test_clients_that_drip_bodies_do_not_lock_others_out(http):
    """More of them than there are places, again and again: every honest request is answered."""
    head = "POST /measure HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{"
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
