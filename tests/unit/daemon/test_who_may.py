"""Who may connect and what a value means: each rule with the cases on both sides of it."""

from __future__ import annotations

from typing import Any

import aiohttp
import pytest

from radiometer.daemon.http.server import ROUTES, HttpServer
from radiometer.daemon.limits import Limits, is_allowed, parse_networks
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station

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
def test_the_allow_list_lets_in_whom_it_names(station: Station, peer: str, allowed: bool) -> None:
    """Loopback always, members of a network, no one else; without a list no one but loopback."""
    networks = parse_networks(["192.168.1.0/24", "10.0.0.7", "fd00::/8"])
    assert is_allowed(peer, networks) is allowed
    assert is_allowed(peer, ()) is (peer in ("127.0.0.1", "::1", "::ffff:127.0.0.1"))
    server = ScpiServer(station, allow=networks)
    assert bool(server.refusal((peer, 5025))) is not allowed
    assert bool(ScpiServer(station).refusal((peer, 5025))) is not is_allowed(peer, ())


async def test_without_the_token_nothing_but_the_public_is_served(station: Station) -> None:
    """Every route that is not public needs the whole token; the public ones measure and tell nothing."""
    server = HttpServer(station, token=TOKEN, limits=Limits(http_requests_per_s=1e4))
    base = f"http://127.0.0.1:{await server.listen('127.0.0.1', 0)}"
    public = {route.path for route in ROUTES if route.public}
    assert not public & {"/readings", "/readings/stream", "/measure", "/settings", "/light", "/light/off", "/status",
                         "/trend", "/patches", "/patches/delete", "/events", "/frame.png", "/metrics"}  # fmt: skip
    async with aiohttp.ClientSession() as session:
        for route in ROUTES:
            for given in (None, "Bearer ", f"Bearer {TOKEN[:-1]}", f"Bearer {TOKEN}x", f"Basic {TOKEN}", TOKEN):
                headers = {"Host": "radiometer.lab"} | ({} if given is None else {"Authorization": given})
                async with session.request(route.method, base + route.path, headers=headers) as reply:
                    assert (reply.status == 401) is (not route.public), (route.path, given)
        async with session.get(f"{base}/status", headers={"Authorization": f"Bearer {TOKEN}"}) as reply:
            assert reply.status == 200
    assert station.shown.latest is None
    await server.close()


@pytest.mark.parametrize("path", ["/light", "/light/off", "/settings", "/measure", "/patches", "/events"])
async def test_another_site_changes_nothing(station: Station, box: Any, path: str) -> None:
    """A post with a foreign origin, and one for a foreign host name, is 403; a read for a foreign host too."""
    server = HttpServer(station)
    base = f"http://127.0.0.1:{await server.listen('127.0.0.1', 0)}"
    async with aiohttp.ClientSession() as session:
        for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Sec-Fetch-Site": "same-site"}):
            async with session.post(base + path, json={}, headers=headers) as reply:
                assert reply.status == 403
        async with session.get(f"{base}/status", headers={"Host": "evil.example"}) as reply:
            assert reply.status == 403
    assert (station.shown.latest, set(box.levels.values())) == (None, {0.0})
    await server.close()
