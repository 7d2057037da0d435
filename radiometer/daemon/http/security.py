"""Who may ask what, and how often."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Awaitable, Callable, Sequence
from typing import Final
from urllib.parse import urlsplit

import structlog
from aiohttp import web
from aiohttp.typedefs import Middleware

from radiometer.daemon.http.requests import ASKER, LIGHTS_OFF, STATION, Route, json_reply, read_whole
from radiometer.daemon.journal import JournalError
from radiometer.daemon.light import Asker
from radiometer.daemon.limits import TokenBucket, is_loopback
from radiometer.daemon.places import Places
from radiometer.errors import (
    DeviceError,
    InputError,
    LightEnded,
    RadiometerError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)

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
