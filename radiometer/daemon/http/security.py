"""Who may ask what, and how often."""

from __future__ import annotations

import hmac
import json
from collections.abc import Awaitable, Callable, Sequence
from typing import Final
from urllib.parse import urlsplit

import structlog
from aiohttp import web
from aiohttp.typedefs import Middleware

from radiometer.daemon.http.route import STATION, Route
from radiometer.daemon.journal import JournalError
from radiometer.daemon.limits import TokenBucket
from radiometer.errors import DeviceError, InputError, RadiometerError, SettingOutOfRange, UnsafeStimulus, UsageError

_log = structlog.get_logger(__name__)
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
LOOPBACK_HOSTS: Final = frozenset({"localhost", "127.0.0.1", "::1"})
_BUCKETS: Final = 4096
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
    text = json.dumps({"error": {"status": status, "message": message}}, ensure_ascii=False) + "\n"
    return web.Response(text=text, status=status, content_type="application/json")


def status_of(error: Exception) -> int:
    """Return the HTTP status of one of our own errors."""
    if isinstance(error, UsageError | SettingOutOfRange | UnsafeStimulus | InputError):
        return 400
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


def guard(routes: Sequence[Route], token: str | None, requests_per_s: float) -> Middleware:
    """Return the middleware that limits rates, refuses foreign origins, and asks for the token where one is set.

    Args:
        routes: The route table; its public routes need no token.
        token: The token; None where only this machine can connect.
        requests_per_s: Sustained rate that one address may have.
    """
    public = {route.path for route in routes if route.public}
    buckets: dict[str, TokenBucket] = {}

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not _within_rate(buckets, request.remote or "", requests_per_s):
            return _refused(request, "rate", 429, f"more than {requests_per_s:g} requests per second")
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


def _within_rate(buckets: dict[str, TokenBucket], peer: str, per_s: float) -> bool:
    bucket = buckets.get(peer)
    if bucket is None:
        if len(buckets) >= _BUCKETS:
            for idle in [name for name, entry in buckets.items() if entry.is_full]:
                del buckets[idle]
        bucket = buckets[peer] = TokenBucket(per_s)
    return bucket.take() == 0.0


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
    return kind.lower() == "bearer" and hmac.compare_digest(given.strip().encode(), token.encode())


def _refused(request: web.Request, reason: str, status: int, message: str) -> web.Response:
    request.app[STATION].metrics.refused.labels("http", reason).inc()
    return error_reply(status, message)
