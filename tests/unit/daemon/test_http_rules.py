"""Each rule of HTTP access on both sides of it: host, origin, token, rate, and what an error is called."""

from __future__ import annotations

import asyncio
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.daemon.http.security import error_reply, status_of
from radiometer.daemon.http.server import ROUTES, HttpServer
from radiometer.daemon.journal import JournalError
from radiometer.daemon.limits import Limits, is_allowed, is_loopback, parse_networks
from radiometer.daemon.scpi.server import ScpiServer
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

# Of the OWASP secure-headers list, what keeps a page from being framed, guessed at, or shown to other sites.
HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-store"}
octets = st.integers(0, 255)


@pytest.mark.parametrize("sign", ["\0", "\t", " ", "\u00a0", "\u200b", "\u202e", "\ufeff", "\ue000", "\ud800"])
@pytest.mark.parametrize("visible", ["", "a-token-so-long-as-it"])
def test_a_token_of_what_cannot_be_seen_is_refused(station, sign, visible):
    """Zero bytes, blanks, marks of no width, private and half characters, alone or at the end of a good token."""
    with pytest.raises(UsageError, match=r"invisible characters.*openssl"):
        HttpServer(station, token=visible + sign * 20)


@pytest.mark.parametrize(
    "sent", [b"Bearer \xff\xfe", b"Bearer \xed\xa0\x80", "Bearer schlüssel-zum-haus".encode("latin-1")]
)
async def test_a_token_of_any_bytes_is_refused_without_an_error(serve, sent):
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

    assert await status(sent) == b"401"
    assert await status("Bearer schlüssel-zum-haus".encode()) == b"200"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200), ({"Host": "localhost:PORT"}, 200), ({"Host": "LOCALHOST:PORT"}, 200), ({"Host": "[::1]:80"}, 200),
        ({"Host": "evil.example:PORT"}, 403), ({"Host": "127.0.0.1.evil.example"}, 403),
        ({"Host": "localhost@evil.example"}, 403), ({"Origin": "http://127.0.0.1:PORT"}, 200),
        ({"Origin": "HTTP://127.0.0.1:PORT"}, 200), ({"Origin": "http://127.0.0.1:1"}, 403),
        ({"Origin": "http://127.0.0.1"}, 403), ({"Origin": "null"}, 403), ({"Origin": "http://[::1"}, 403),
        ({"Origin": "http://127.0.0.1:PORT.evil.example"}, 403), ({"Sec-Fetch-Site": "same-origin"}, 200),
        ({"Sec-Fetch-Site": "none"}, 200), ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Origin": "http://127.0.0.1:PORT"}, 403),
        ({"Content-Type": "text/plain"}, 415),
    ],
)  # fmt: skip
async def test_only_pages_of_this_host_and_origin_may_change_anything(http, headers, status):
    """Scheme aside, host and port must be those asked; no header at all is no browser."""
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


@pytest.mark.parametrize(
    ("address", "loopback"),
    [("127.0.0.1", True), ("127.8.9.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),
     ("192.168.1.1", False), ("10.0.0.1", False), ("", False), ("example", False)],
)  # fmt: skip
async def test_only_loopback_may_be_open_without_a_token(station, address, loopback):
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
def test_errors_have_their_status(error, status):
    """The asker's mistake, the device's trouble, the time that ran out, and what cannot be measured."""
    assert status_of(error) == status
    reply = error_reply(status, 'a "word" ×')
    assert reply.status == status
    assert json.loads(reply.text or "") == {"error": {"status": status, "message": 'a "word" ×'}}


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


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (KeyError("secret"), 500, "unexpected error; the daemon's log has the particulars"),
        (TimeoutError(), 504, "no reading within the deadline"), (TimeoutError("late"), 504, "late"),
        (DeviceLost("gone"), 503, "gone"), (MeasurementError("dark"), 422, "dark"),
    ],
)  # fmt: skip
async def test_what_a_measurement_ends_in_is_reported_as_json(http, station, monkeypatch, error, status, message):
    """Our own errors in their words, a bug without them; with the headers of every reply, and the next is served."""

    async def failing(*_, **__):
        raise error

    monkeypatch.setattr(station.acquisition, "measure", failing)
    reply = await http.post("/measure", json={})
    assert (reply.status, reply.json()) == (status, {"error": {"status": status, "message": message}})
    assert {name: reply.headers.get(name) for name in HEADERS} == HEADERS
    assert (await http.get("/status")).status == 200


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


@pytest.mark.parametrize(
    ("peer", "allowed"),
    [
        ("127.0.0.1", True), ("::1", True), ("::ffff:127.0.0.1", True),
        ("192.168.1.7", True), ("192.168.2.7", False), ("10.0.0.7", True), ("10.0.0.8", False),
        ("::ffff:192.168.1.7", True), ("::ffff:192.168.2.7", False), ("fd00::1", True), ("fe00::1", False),
        ("fd00::5%eth0", True), ("fe80::1%eth0", False),
        ("8.8.8.8", False), ("", False), ("nonsense", False), ("192.168.1.7.evil.example", False),
    ],
)  # fmt: skip
def test_the_allow_list_lets_in_whom_it_names(station, peer, allowed):
    """Loopback always, members of a network, no one else; without a list no one but loopback."""
    networks = parse_networks(["192.168.1.0/24", "10.0.0.7", "fd00::/8"])
    assert is_allowed(peer, networks) is allowed
    assert is_allowed(peer, ()) is (peer in ("127.0.0.1", "::1", "::ffff:127.0.0.1"))
    server = ScpiServer(station, allow=networks)
    assert bool(server.refusal((peer, 5025))) is not allowed
    assert bool(ScpiServer(station).refusal((peer, 5025))) is not is_allowed(peer, ())


async def test_without_the_token_nothing_but_the_public_is_served(serve, station):
    """Every route that is not public needs the whole token, after Bearer in any case; public ones tell nothing."""
    http = await serve(token=TOKEN, limits=Limits(http_requests_per_s=1e4))
    public = {route.path for route in ROUTES if route.public}
    assert not public & {"/readings", "/readings/stream", "/measure", "/settings", "/light", "/light/off", "/status",
                         "/trend", "/patches", "/patches/delete", "/events", "/frame.png", "/metrics"}  # fmt: skip
    wrong = (
        "",
        "Bearer ",
        f"Bearer {TOKEN[:-1]}",
        f"Bearer {TOKEN}x",
        f"Basic {TOKEN}",
        TOKEN,
        f"Bearer {TOKEN.title()}",
    )
    for route in ROUTES:
        for stated in (None, *wrong):
            headers = {"Host": "radiometer.lab"} | ({} if stated is None else {"Authorization": stated})
            async with http.session.request(route.method, route.path, headers=headers) as reply:
                assert (reply.status == 401) is (not route.public), (route.path, stated)
    assert station.shown.latest is None
    for word in ("Bearer ", "bearer  ", "BEARER "):
        assert (await http.get("/status", headers={"Authorization": word + TOKEN})).status == 200


@pytest.mark.parametrize("path", ["/light", "/light/off", "/settings", "/measure", "/patches", "/events"])
async def test_another_site_changes_nothing(http, station, box, path):
    """A post with a foreign origin, and one for a foreign host name, is 403; a read for a foreign host too."""
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Sec-Fetch-Site": "same-site"}):
        assert (await http.post(path, json={}, headers=headers)).status == 403
    assert (await http.get("/status", headers={"Host": "evil.example"})).status == 403
    assert (station.shown.latest, set(box.levels.values())) == (None, {0.0})
