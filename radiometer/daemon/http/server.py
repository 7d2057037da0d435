"""The HTTP server: routes, page, limits on connections."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from importlib import resources
from typing import Final

import structlog
from aiohttp import web

from radiometer.daemon.descriptors import listen
from radiometer.daemon.http import control, patches, picture, readings
from radiometer.daemon.http.openapi import description
from radiometer.daemon.http.requests import BUDGET, LIMITS, QUERIES, STATION, Route, json_reply
from radiometer.daemon.http.security import guard, report_errors
from radiometer.daemon.limits import Limits, ReplyBudget, check_token, is_loopback
from radiometer.daemon.places import Places
from radiometer.daemon.station import Station
from radiometer.errors import OutputError, UsageError
from radiometer.reporting.server_log import logger_of_server

_log = structlog.get_logger(__name__)
_KEEP_ALIVE_S: Final = 30.0  # twice the heartbeat of a stream
# Between two requests of a busy client: with all places taken a connection that waits for so long makes room, so that
# "Lights off" always gets in. A client of HTTP connects again.
_IDLE_S: Final = 0.1
_PAGE: Final = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/lights.js": ("lights.js", "text/javascript"),
    "/server.js": ("server.js", "text/javascript"),
    "/text.js": ("text.js", "text/javascript"),
    "/trends.js": ("trends.js", "text/javascript"),
    "/response.js": ("response.js", "text/javascript"),
    "/uplot.js": ("uplot/uPlot.esm.js", "text/javascript"),
    "/uplot.css": ("uplot/uPlot.min.css", "text/css"),
    "/uplot-licence.txt": ("uplot/LICENSE", "text/plain"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}


class HttpServer:
    """Serves one station over HTTP.

    Args:
        limits: What clients may use.
        token: What clients must send, 16 characters or more; None where only loopback is listened on.

    Raises:
        UsageError: If the token is shorter.
    """

    def __init__(self, station: Station, *, limits: Limits | None = None, token: str | None = None) -> None:
        self._station, self._limits, self._token = station, limits or Limits(), token
        if token is not None:
            check_token(token)
        self._places: Places[web.RequestHandler] = Places(self._limits.http_connections, idle_s=_IDLE_S)
        self._runner = web.AppRunner(
            application(station, self._limits, token, self._places),
            access_log=None,
            logger=logger_of_server(__name__),
            keepalive_timeout=_KEEP_ALIVE_S,  # also ends a connection that never finishes its request head
            shutdown_timeout=2.0,
            max_field_size=8190,
            max_line_size=8190,
        )
        self._server: asyncio.Server | None = None
        station.metrics.connections.labels("http").set_function(self._count)

    async def listen(self, address: str, port: int) -> int:
        """Listen and return the port (0 chooses a free one).

        Raises:
            UsageError: If the address is not loopback and there is no token.
            OutputError: If the port is taken.
        """
        if not is_loopback(address) and self._token is None:
            raise UsageError(
                f"to listen for HTTP on {address}, set a token with --token-file (or RADIOMETER_TOKEN), or stay on"
                " 127.0.0.1"
            )
        await self._runner.setup()
        try:
            self._server = await listen(self._accept, address, port)
        except OSError as error:
            raise OutputError(f"cannot listen for HTTP on {address}:{port}: {error.strerror or error}") from error
        return int(self._server.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Stop listening, end streams and requests."""
        self._station.hub.close()
        if self._server is not None:
            self._server.close()
        await self._runner.cleanup()
        if self._server is not None:
            await self._server.wait_closed()

    def _count(self) -> int:
        return len(self._runner.server.connections) if self._runner.server else 0

    def _accept(self) -> asyncio.BaseProtocol:
        """Return what serves the next connection: its address is known once it is made."""
        return _Doorman(self._admit)

    def _admit(self, peer: str) -> web.RequestHandler | None:
        """Return the handler of a new connection; None where it is refused."""
        if (server := self._runner.server) is None:  # connected while the daemon ends
            return None
        for gone in self._places.connections() - set(server.connections):
            self._places.leave(gone)
        if (displaced := self._places.make_room(peer)) is not None:
            self._end(displaced)
        reason = self._places.refusal(peer) or ("too many connections" if self._places.is_full else "")
        if reason:
            self._station.metrics.refused.labels("http", reason).inc()
            return None
        handler = server()
        self._places.enter(handler, peer)
        asyncio.get_running_loop().call_later(self._limits.head_s, self._look_at_head, handler)
        return handler

    def _look_at_head(self, handler: web.RequestHandler) -> None:
        """End a connection whose first request head has not come in time."""
        server = self._runner.server  # None once the daemon has ended, which has ended all connections
        if server is not None and handler in server.connections and not self._places.is_known(handler):
            self._end(handler)

    def _end(self, handler: web.RequestHandler) -> None:
        self._station.metrics.refused.labels("http", "dropped").inc()
        handler.force_close()
        self._places.leave(handler)


class _Doorman(asyncio.Protocol):
    """Hands a new connection to its handler, or refuses a surplus client with a reply and hangs up."""

    def __init__(self, admit: Callable[[str], web.RequestHandler | None]) -> None:
        self._admit = admit

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        peer = transport.get_extra_info("peername")
        handler = self._admit(str(peer[0]) if isinstance(peer, tuple) else "")
        if handler is None:
            transport.write(b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
            transport.close()
            return
        transport.set_protocol(handler)
        handler.connection_made(transport)


def application(
    station: Station, limits: Limits, token: str | None, places: Places[web.RequestHandler]
) -> web.Application:
    """Return the application: every route of the table, and the page."""
    app = web.Application(
        client_max_size=limits.body_bytes,
        middlewares=[report_errors, guard(ROUTES, token, limits.http_requests_per_s, places)],
    )
    app[STATION], app[LIMITS], app[QUERIES] = station, limits, asyncio.Semaphore(limits.queries)
    app[BUDGET] = ReplyBudget(limits.large_replies_bytes)
    app[picture.CACHE], app[picture.ONE_AT_A_TIME] = picture.PictureCache(), asyncio.Lock()
    for route in ROUTES:
        app.router.add_route(route.method, route.path, route.handler)
        if route.method == "GET":
            app.router.add_route("HEAD", route.path, route.handler)  # aiohttp leaves the body out
    return app


async def _show_openapi(request: web.Request) -> web.Response:
    return json_reply(description(ROUTES))


def _page_route(path: str, name: str, kind: str) -> Route:
    content = resources.files("radiometer.daemon.http").joinpath("page", *name.split("/")).read_bytes()

    async def serve(request: web.Request) -> web.Response:
        return web.Response(body=content, content_type=kind, charset="utf-8")

    return Route(
        "GET", path, serve, "The web page." if path == "/" else "Part of the web page.", reply=kind, public=True
    )


ROUTES: Final[tuple[Route, ...]] = (
    *readings.ROUTES,
    *control.ROUTES,
    *patches.ROUTES,
    *picture.ROUTES,
    Route("GET", "/openapi.json", _show_openapi, "This description.", schema="OpenAPI", public=True),
    *(_page_route(path, name, kind) for path, (name, kind) in _PAGE.items()),
)
