"""Each rule of HTTP access on both sides of it: host, origin, token, rate, and what an error is called."""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import aiohttp
import pytest
from aiohttp.test_utils import make_mocked_request
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from radiometer.daemon.http import security
from radiometer.daemon.http import server as http_server
from radiometer.daemon.http.security import _HEADERS, _has_token, _host_of, _Rates, _same_origin, error_reply, status_of
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.journal import JournalError
from radiometer.daemon.limits import Limits, is_allowed, is_loopback, parse_networks
from radiometer.daemon.station import Station
from radiometer.errors import (
    CalibrationError,
    DeviceLost,
    InputError,
    MeasurementError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)
from testing.patience import within

octets = st.integers(0, 255)


@pytest.mark.parametrize(
    ("host", "name"),
    [
        ("localhost:8080", "localhost"), ("127.0.0.1", "127.0.0.1"), ("[::1]:80", "::1"), ("LOCALHOST", "localhost"),
        ("evil.example:8080", "evil.example"), ("localhost.evil.example", "localhost.evil.example"), ("", ""),
        ("127.0.0.1.evil.example", "127.0.0.1.evil.example"), ("localhost@evil.example", "evil.example"), ("[::1", ""),
    ],
)  # fmt: skip
def test_the_host_is_the_name_without_its_port(host: str, name: str) -> None:
    """Whatever stands around it; what is no host is none."""
    assert _host_of(host) == name
    assert (name in security.LOOPBACK_HOSTS) == (name in ("localhost", "127.0.0.1", "::1"))


@pytest.mark.parametrize(
    ("headers", "same"),
    [
        ({}, True),
        ({"Origin": "http://127.0.0.1:8080"}, True),
        ({"Origin": "HTTP://127.0.0.1:8080"}, True),
        ({"Origin": "http://127.0.0.1:8081"}, False),
        ({"Origin": "http://127.0.0.1"}, False),
        ({"Origin": "http://7"}, False),
        ({"Origin": "null"}, False),
        ({"Origin": ""}, False),
        ({"Origin": "http://[::1"}, False),
        ({"Origin": "http://127.0.0.1:8080.evil.example"}, False),
        ({"Sec-Fetch-Site": "same-origin"}, True),
        ({"Sec-Fetch-Site": "none"}, True),
        ({"Sec-Fetch-Site": "same-site"}, False),
        ({"Sec-Fetch-Site": "cross-site"}, False),
        ({"Sec-Fetch-Site": "cross-site", "Origin": "http://127.0.0.1:8080"}, False),
    ],
)
def test_an_origin_is_the_same_or_another(headers: dict[str, str], same: bool) -> None:
    """Scheme aside, host and port must be those asked; no header at all is no browser."""
    assert _same_origin(make_mocked_request("POST", "/light", {"Host": "127.0.0.1:8080", **headers})) is same


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=20))
def test_the_whole_token_opens_and_nothing_else(given_token: str) -> None:
    """Bearer in any case and the token, letter for letter."""
    token = "the-token-it-is"

    def opens(header: str) -> bool:
        request: Any = SimpleNamespace(headers={"Authorization": header})
        return _has_token(request, token)

    assert opens(f"Bearer {token}")
    assert opens(f"bearer  {token}")
    assert opens(f"Bearer {given_token}") is (given_token == token)
    assert not opens(f"Basic {token}")
    assert not opens(token)
    assert not opens(f"Bearer {token[:-1]}")
    assert not opens("Bearer ")


@pytest.mark.parametrize("sent", [b"Bearer \xff\xfe", b"Bearer \xed\xa0\x80", "Bearer schlüssel".encode("latin-1")])
async def test_a_token_of_any_bytes_is_refused_without_an_error(station: Station, sent: bytes) -> None:
    """What is no UTF-8 is a wrong token like any other: 401, and nothing in the log; in UTF-8 it opens."""
    server = HttpServer(station, token="schlüssel")
    port = await server.listen("127.0.0.1", 0)

    async def status(header: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        head = b"GET /status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: "
        writer.write(head + header + b"\r\n\r\n")
        async with asyncio.timeout(within(10.0)):
            reply = await reader.read()
        writer.close()
        return reply.split(b" ", 2)[1]

    with capture_logs() as logged:
        assert await status(sent) == b"401"
    assert logged == []
    assert await status("Bearer schlüssel".encode()) == b"200"
    await server.close()


@given(octets, octets, octets, octets, st.integers(0, 32))
def test_a_network_holds_the_addresses_that_share_its_bits(a: int, b: int, c: int, d: int, prefix: int) -> None:
    """Address by address, mapped into IPv6 too, by shifting instead of a library."""
    networks = parse_networks([f"{a}.{b}.{c}.{d}/{prefix}"])
    bits = a << 24 | b << 16 | c << 8 | d
    for flipped in (0, 1 << 31, 1 << 24, 1 << 16, 1 << 8, 1):
        other = bits ^ flipped
        inside = (other >> (32 - prefix)) == (bits >> (32 - prefix)) or other >> 24 == 127
        text = ".".join(str(other >> shift & 255) for shift in (24, 16, 8, 0))
        assert is_allowed(text, networks) is inside
        assert is_allowed(f"::ffff:{text}", networks) is inside


@pytest.mark.parametrize(
    ("address", "loopback"),
    [("127.0.0.1", True), ("127.8.9.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),
     ("192.168.1.1", False), ("10.0.0.1", False), ("", False), ("example", False)],
)  # fmt: skip
async def test_only_loopback_may_be_open_without_a_token(station: Station, address: str, loopback: bool) -> None:
    """Every other address is refused with the way out before anything listens."""
    assert is_loopback(address) is loopback
    if not loopback:
        server = HttpServer(station)
        with pytest.raises(UsageError, match="--token-file"):
            await server.listen(address, 0)
        await server.close()


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (UsageError("x"), 400), (SettingOutOfRange("c", "gain", 1.0, 0.0, 0.5, "dB"), 400), (UnsafeStimulus("x"), 400),
        (InputError("x"), 400), (DeviceLost("x"), 503), (JournalError("x"), 503), (TimeoutError("x"), 504),
        (MeasurementError("x"), 422), (CalibrationError("x"), 400),
    ],
)  # fmt: skip
def test_errors_have_their_status(error: Exception, status: int) -> None:
    """The asker's mistake, the device's trouble, the time that ran out, and what cannot be measured."""
    assert status_of(error) == status
    reply = error_reply(status, 'a "word" ×')
    assert reply.status == status
    assert json.loads(reply.text or "") == {"error": {"status": status, "message": 'a "word" ×'}}


class Known:
    """All connections are known already."""

    def is_known(self, protocol: Any) -> bool:
        return True


async def test_each_address_has_a_rate_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five of one address, then none until time has passed; another address still has its five."""
    now = [0.0]
    monkeypatch.setattr(security, "TokenBucket", lambda per_s: real(per_s, lambda: now[0]))
    rates: Any = _Rates(5.0, Known())  # type: ignore[arg-type]
    one, other = SimpleNamespace(remote="10.0.0.1", protocol=1), SimpleNamespace(remote="10.0.0.2", protocol=2)
    assert [await rates.admits(one) for _ in range(7)] == [True] * 5 + [False] * 2
    assert await rates.admits(other)
    now[0] = 0.2
    assert [await rates.admits(one) for _ in range(2)] == [True, False]
    here, there = (SimpleNamespace(remote="127.0.0.1", protocol=number) for number in (3, 4))
    assert [await rates.admits(here) for _ in range(6)] == [True] * 5 + [False]
    assert await rates.admits(there)


real = security.TokenBucket


async def test_every_reply_carries_the_headers_that_keep_the_page_whole(station: Station) -> None:
    """Success, error and refusal alike; what is refused is JSON that says why."""
    server = HttpServer(station, limits=Limits(http_requests_per_s=1e4))
    base = f"http://127.0.0.1:{await server.listen('127.0.0.1', 0)}"
    async with aiohttp.ClientSession() as session:
        for path, headers, status in (
            ("/status", {}, 200), ("/nothing", {}, 404), ("/status", {"Host": "evil.example"}, 403),
            ("/readings?limit=x", {}, 400),
        ):  # fmt: skip
            async with session.get(base + path, headers=headers) as reply:
                assert reply.status == status
                assert {name: reply.headers.get(name) for name in _HEADERS} == _HEADERS
                if status != 200:
                    assert (await reply.json())["error"]["status"] == status
    assert "frame-ancestors 'none'" in _HEADERS["Content-Security-Policy"]
    assert "script-src 'self'" in _HEADERS["Content-Security-Policy"]
    await server.close()


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (KeyError("secret"), 500, "unexpected error; the daemon's log has the particulars"),
        (TimeoutError(), 504, "no reading within the deadline"), (TimeoutError("late"), 504, "late"),
        (DeviceLost("gone"), 503, "gone"), (MeasurementError("dark"), 422, "dark"),
    ],
)  # fmt: skip
async def test_what_a_measurement_ends_in_is_said_as_json(
    station: Station, monkeypatch: pytest.MonkeyPatch, error: Exception, status: int, message: str
) -> None:
    """Our own errors in their words, a bug without them; with the headers of every reply, and the next is served."""

    async def failing(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(station.acquisition, "measure", failing)
    server = HttpServer(station, limits=Limits(http_requests_per_s=1e4))
    base = f"http://127.0.0.1:{await server.listen('127.0.0.1', 0)}"
    async with aiohttp.ClientSession() as session:
        async with session.post(f"{base}/measure", json={}) as reply:
            assert (reply.status, await reply.json()) == (status, {"error": {"status": status, "message": message}})
            assert {name: reply.headers.get(name) for name in _HEADERS} == _HEADERS
        async with session.get(f"{base}/status") as reply:
            assert reply.status == 200
    await server.close()


async def test_a_newcomer_waits_for_its_turn_and_is_refused_after_fifty(monkeypatch: pytest.MonkeyPatch) -> None:
    """New connections of this machine share one rate: the sixth waits as long as is said; not for ever."""
    now, waited = [0.0], list[float]()

    async def sleep(seconds: float) -> None:
        waited.append(seconds)
        now[0] += seconds * passes

    monkeypatch.setattr(security, "TokenBucket", lambda per_s: real(per_s, lambda: now[0]))
    monkeypatch.setattr(security.asyncio, "sleep", sleep)
    rates: Any = _Rates(5.0, Unknown())  # type: ignore[arg-type]
    passes = 1.0
    newcomers = [SimpleNamespace(remote="127.0.0.1", protocol=number) for number in range(8)]
    assert [await rates.admits(one) for one in newcomers[:5]] == [True] * 5
    assert waited == []
    assert await rates.admits(newcomers[5])
    assert waited[0] == pytest.approx(0.2)
    passes, before = 0.0, len(waited)
    assert not await rates.admits(newcomers[6])
    assert len(waited) - before == 50


class Unknown:
    """No connection is known."""

    def is_known(self, protocol: Any) -> bool:
        return False


async def test_who_is_connected_when_the_server_closes_is_hung_up_on(
    station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A connection that is kept alive ends at once, however long it might stay; new ones are refused."""
    monkeypatch.setattr(http_server, "_KEEP_ALIVE_S", 1e4)
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


@pytest.mark.parametrize(("connected", "known", "ended"), [(True, False, 1), (False, False, 0), (True, True, 0)])
async def test_only_a_connection_that_is_open_and_silent_is_ended(
    station: Station, monkeypatch: pytest.MonkeyPatch, connected: bool, known: bool, ended: int
) -> None:
    """One that has left by itself, or sent its request, is neither hung up on nor counted as dropped."""
    handler: Any = MagicMock()
    server = HttpServer(station)
    await server.listen("127.0.0.1", 0)
    monkeypatch.setattr(type(server._runner.server), "connections", [handler] * connected)
    monkeypatch.setattr(server._places, "is_known", lambda _handler: known)
    server._look_at_head(handler)
    monkeypatch.undo()
    await server.close()
    assert handler.force_close.call_count == ended
    dropped = station.metrics.refused.labels("http", "dropped")._value.get()
    assert dropped == ended
