"""The HTTP server: routes and their description, the page, who may ask what and how often, limits on connections."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Awaitable, Callable, Sequence
from importlib import resources
from typing import Any, Final
from urllib.parse import urlsplit

import structlog
from aiohttp import web
from aiohttp.typedefs import Middleware

import radiometer
from radiometer.daemon.http import picture
from radiometer.daemon.http.requests import (
    ASKER,
    BUDGET,
    LIGHTS_OFF,
    LIMITS,
    QUERIES,
    STATION,
    LimitsBody,
    PatchBody,
    Route,
    json_reply,
    read_whole,
)
from radiometer.daemon.http.resources import CONTROL_ROUTES, PATCH_ROUTES, READING_ROUTES
from radiometer.daemon.journal import JournalError
from radiometer.daemon.light import Asker
from radiometer.daemon.limits import Limits, Places, ReplyBudget, TokenBucket, check_token, is_loopback
from radiometer.daemon.resources import listen
from radiometer.daemon.station import Station
from radiometer.data import Flag
from radiometer.errors import (
    DeviceError,
    InputError,
    LightEnded,
    OutputError,
    RadiometerError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)
from radiometer.reporting.server_log import logger_of_server

_NUMBER_OR_NULL: Final = {"type": ["number", "null"]}
_QUANTITY: Final = {
    "type": "object",
    "required": ["value", "u", "unit"],
    "properties": {
        "value": _NUMBER_OR_NULL,
        "u": {**_NUMBER_OR_NULL, "description": "Standard uncertainty (k=1)."},
        "unit": {"type": "string"},
    },
}
_INTEGER: Final = {"type": "integer"}
_STRING: Final = {"type": "string"}
_SCHEMAS: Final[dict[str, Any]] = {
    "Quantity": _QUANTITY,
    "Patch": {
        "type": "object",
        "required": ["x", "y", "width", "height"],
        "properties": dict.fromkeys(("x", "y", "width", "height"), _INTEGER),
    },
    "Reading": {
        "type": "object",
        "required": ["time", "instrument", "patch", "radiance", "luminance", "flags", "exposures_s", "sequence"],
        "properties": {
            "time": {"type": "string", "format": "date-time"},
            "instrument": _STRING,
            "patch": {"$ref": "#/components/schemas/Patch"},
            "radiance": {"$ref": "#/components/schemas/Quantity"},
            "luminance": {"oneOf": [{"$ref": "#/components/schemas/Quantity"}, {"type": "null"}]},
            "coverage_factor": {"type": "number"},
            "band_nm": {"type": "array", "items": {"type": "number"}, "description": "Light that the radiance counts."},
            "U_rel": {**_NUMBER_OR_NULL, "description": "Expanded relative uncertainty."},
            "flags": {"type": "array", "items": {"type": "string", "enum": [str(flag) for flag in Flag]}},
            "exposures_s": {"type": "array", "items": {"type": "number"}},
            "sequence": _INTEGER,
        },
    },
    "PatchBody": PatchBody.model_json_schema(),
    "LimitsBody": LimitsBody.model_json_schema(),
    "Readings": {"type": "array", "items": {"$ref": "#/components/schemas/Reading"}},
    "Status": {"type": "object"},
    "Light": {"type": "object", "properties": {"channel": _STRING, "level": {"type": "number"}}},
    "Response": {
        "type": "object",
        "properties": {
            name: {"type": "array", "items": {"type": "number"}} for name in ("dn", "log_exposure", "u_log_exposure")
        },
    },
    "Events": {
        "type": "array",
        "items": {"type": "object", "properties": dict.fromkeys(("time", "kind", "message"), _STRING)},
    },
    "Event": {"type": "object", "properties": dict.fromkeys(("kind", "message"), _STRING)},
    "Trend": {
        "type": "object",
        "properties": {
            "unit": _STRING,
            **{
                name: {"type": "array", "items": _NUMBER_OR_NULL}
                for name in ("time", "value", "U", "low", "high", "count", "flagged")
            },
            "bound": {"type": "array", "items": {"type": ["string", "null"]}},
        },
    },
    "Health": {
        "type": "object",
        "properties": {"status": {"type": "string", "enum": ["ok", "alarm"]}, "alarms": {"type": "array"}},
    },
    "OpenAPI": {"type": "object"},
    "Error": {
        "type": "object",
        "properties": {"error": {"type": "object", "properties": {"status": _INTEGER, "message": _STRING}}},
    },
}


def description(routes: Sequence[Route]) -> dict[str, Any]:
    """Return the OpenAPI 3.1 description of the routes."""
    paths: dict[str, dict[str, Any]] = {}
    for route in routes:
        paths.setdefault(route.path, {})[route.method.lower()] = _operation(route)
    return {
        "openapi": "3.1.0",
        "info": {"title": "radiometer", "version": radiometer.__version__},
        "paths": paths,
        "components": {"schemas": _SCHEMAS, "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
        "security": [{}, {"token": []}],
    }


def _operation(route: Route) -> dict[str, Any]:
    schema: dict[str, Any] = {"$ref": f"#/components/schemas/{route.schema}"} if route.schema else {"type": "string"}
    failure = {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}}
    operation: dict[str, Any] = {
        "summary": route.summary,
        "parameters": [
            {"name": name, "in": "query", "description": stated.pop("description"), "schema": stated}
            for name, stated in (route.query.model_json_schema()["properties"] if route.query else {}).items()
        ],
        "responses": {
            "200": {"description": "Done.", "content": {route.reply: {"schema": schema}}},
            "400": {"description": "The request is wrong; nothing was changed.", **failure},
            "503": {"description": "A device or the journal is not there.", **failure},
        },
    }
    if route.body is not None:
        body = route.body.model_json_schema(ref_template="#/components/schemas/{model}")
        body.pop("$defs", None)
        operation["requestBody"] = {"content": {"application/json": {"schema": body}}}
    return operation


_log = structlog.get_logger(__name__)
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
LOOPBACK_HOSTS: Final = frozenset({"localhost", "127.0.0.1", "::1"})
_BUCKETS: Final = 512  # addresses counted at a time; those that have rested are forgotten first
_TURNS: Final = 50  # at most so often a newcomer tries to get its turn
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:;"
    " connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Server": "radiometer",
}


def error_reply(status: int, message: str) -> web.Response:
    """Return an error as JSON."""
    return json_reply({"error": {"status": status, "message": message}}, status)


def status_of(error: Exception) -> int:
    """Return the HTTP status of one of our own errors."""
    if isinstance(error, UsageError | SettingOutOfRange | UnsafeStimulus | InputError):
        return 400
    if isinstance(error, LightEnded):
        return 409
    if isinstance(error, DeviceError | JournalError):
        return 503
    return 504 if isinstance(error, TimeoutError) else 422


@web.middleware
async def report_errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Turn every error into JSON without a traceback, and put the security headers on every reply."""
    request.app[STATION].metrics.requests.labels("http").inc()
    try:
        response = await handler(request)
    except web.HTTPException as error:
        text = error.text if error.text and not error.text.startswith(f"{error.status}:") else error.reason
        response = error_reply(error.status, text)
        if isinstance(error, web.HTTPMethodNotAllowed):
            response.headers["Allow"] = ", ".join(sorted(error.allowed_methods))
    except (RadiometerError, TimeoutError) as error:
        response = error_reply(status_of(error), str(error) or "no reading within the deadline")
    except ConnectionError:
        raise
    except Exception:  # noqa: BLE001 (the daemon's edge: one request must not end the daemon)
        _log.exception("unexpected error in a request", path=request.path)
        response = error_reply(500, "unexpected error; the daemon's log has the particulars")
    if not response.prepared:
        for name, value in _HEADERS.items():
            response.headers.setdefault(name, value)
    return response


def guard(
    routes: Sequence[Route], token: str | None, requests_per_s: float, places: Places[web.RequestHandler]
) -> Middleware:
    """Return the middleware that limits rates, refuses foreign origins, and asks for the token where one is set.

    Args:
        routes: The route table; its public routes need no token.
        token: The token; None where only this machine can connect.
        requests_per_s: Sustained rate that one address may have; on loopback, where all clients have one address, one
            connection, and all new connections together: those wait their turn.
    """
    public = {route.path for route in routes if route.public}
    rates = _Rates(requests_per_s, places)

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        ASKER.set(Asker(request.app[STATION].light.darkened_by_others()))  # before it waits
        within_rate = darkens(request) or await rates.admits(request)
        if within_rate:
            await read_whole(request)  # before it is busy: who drips a body has no claim to its place
        places.note(request.protocol, busy=True)
        try:
            return await serve(request, handler) if within_rate else _too_fast(request)
        finally:
            places.note(request.protocol, busy=False)

    def darkens(request: web.Request) -> bool:
        """Return whether it switches the lights off, with the right to do so: others of its address cannot delay it."""
        darkens = request.method == "POST" and request.path == LIGHTS_OFF
        return darkens and (token is None or _has_token(request, token))

    def _too_fast(request: web.Request) -> web.Response:
        return _refused(request, "rate", 429, f"more than {requests_per_s:g} requests per second")

    async def serve(request: web.Request, handler: Handler) -> web.StreamResponse:
        if token is None and _host_of(request.host) not in LOOPBACK_HOSTS:
            return _refused(request, "host", 403, "this daemon answers to localhost only")  # DNS rebinding
        if request.method not in ("GET", "HEAD") and not _same_origin(request):
            return _refused(request, "origin", 403, "requests from other sites are refused")
        if token is not None and request.path not in public and not _has_token(request, token):
            refusal = _refused(request, "token", 401, "send Authorization: Bearer <token>")
            refusal.headers["WWW-Authenticate"] = "Bearer"
            return refusal
        return await handler(request)

    return check


class _Rates:
    """Who may make how many requests."""

    def __init__(self, per_s: float, places: Places[web.RequestHandler]) -> None:
        self._per_s, self._places = per_s, places
        self._buckets: dict[object, TokenBucket] = {}
        self._newcomers = TokenBucket(per_s)

    async def admits(self, request: web.Request) -> bool:
        """Return whether a request is within its rate; the first of a new loopback connection may have to wait."""
        peer = request.remote or ""
        if not is_loopback(peer):
            return self._bucket(peer).take() == 0.0
        if self._places.is_known(request.protocol):
            return self._bucket(request.protocol).take() == 0.0
        for _ in range(_TURNS):
            if (wait_s := self._newcomers.take()) == 0.0:
                return self._bucket(request.protocol).take() == 0.0
            await asyncio.sleep(wait_s)
        return False

    def _bucket(self, whose: object) -> TokenBucket:
        bucket = self._buckets.get(whose)
        if bucket is None:
            if len(self._buckets) >= _BUCKETS:
                for idle in [name for name, entry in self._buckets.items() if entry.is_full]:
                    del self._buckets[idle]
            bucket = self._buckets[whose] = TokenBucket(self._per_s)
        return bucket


def _host_of(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _same_origin(request: web.Request) -> bool:
    if request.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
        return False
    origin = request.headers.get("Origin")
    if origin is None:
        return True  # not a browser
    try:
        return urlsplit(origin).netloc.lower() == request.host.lower()
    except ValueError:
        return False


def _has_token(request: web.Request, token: str) -> bool:
    kind, _, given = request.headers.get("Authorization", "").partition(" ")
    sent = given.strip().encode(errors="surrogateescape")  # bytes that are no UTF-8 are no token, and no error
    return kind.lower() == "bearer" and hmac.compare_digest(sent, token.encode())


def _refused(request: web.Request, reason: str, status: int, message: str) -> web.Response:
    request.app[STATION].metrics.refused.labels("http", reason).inc()
    return error_reply(status, message)


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
    *READING_ROUTES,
    *CONTROL_ROUTES,
    *PATCH_ROUTES,
    *picture.ROUTES,
    Route("GET", "/openapi.json", _show_openapi, "This description.", schema="OpenAPI", public=True),
    *(_page_route(path, name, kind) for path, (name, kind) in _PAGE.items()),
)
