"""Serves one page on loopback only, behind a key in its address, and holds a socket to each browser that shows it."""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from typing import Any, Final, Protocol, TypeVar

from aiohttp import WSMsgType, web

from radiometer.data.json_text import parsed_json
from radiometer.errors import DeviceError, DeviceInUse, RadiometerError

_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
}
_TIMEOUT_S: Final = 10.0  # loopback takes ms; a machine that swaps takes seconds

Message = dict[str, Any]
Darken = Callable[[], str]
Result = TypeVar("Result")


def nothing_to_darken() -> str:
    """Return what a page says that was given no way to a light box."""
    return "this page knows of no light box"


async def darkened(darken: Darken) -> Message:
    """Darken the light box, however long it takes, and return the message for the page."""
    try:
        return {"kind": "outcome", "text": await asyncio.to_thread(darken)}
    except RadiometerError as error:
        return {"kind": "outcome", "text": f"not dark: {error}"}


class Host(Protocol):
    """Who talks with the page; called on the server's own thread."""

    async def joined(self, socket: web.WebSocketResponse) -> None:
        """Take a browser that has just connected."""

    def received(self, message: Message) -> None:
        """Take a message of a browser."""

    def left(self, socket: web.WebSocketResponse) -> None:
        """Forget a browser that has gone."""


class LoopbackServer:
    """An HTTP server in a separate thread, on 127.0.0.1.

    Args:
        port: Port; 0 for any free one.
    """

    def __init__(self, page: str, host: Host, port: int = 0, *, what: str = "page") -> None:
        self._text, self._host, self._port, self._what = page, host, port, what
        self._key = secrets.token_urlsafe(12)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name=what, daemon=True)
        self._started: Future[int] = Future()

    @property
    def url(self) -> str:
        """Return the address to open in a browser. Raises DeviceError unless started."""
        if not self._started.done():
            raise DeviceError(f"the {self._what} is not served yet; open it first")
        return f"http://127.0.0.1:{self._started.result()}/?key={self._key}"

    def start(self) -> None:
        """Start serving. Raises DeviceInUse where the port is taken."""
        self._thread.start()
        try:
            self._started.result(_TIMEOUT_S)
        except OSError as error:
            raise DeviceInUse(
                f"cannot serve the {self._what} on port {self._port}: {error.strerror or error}; choose another port"
            ) from error

    def run(self, work: Coroutine[Any, Any, Result], timeout_s: float = _TIMEOUT_S) -> Result:
        """Return the result of work done on the server's thread. Raises TimeoutError where it takes longer."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(timeout_s)

    def soon(self, act: Callable[[], None]) -> None:
        """Have something done on the server's thread; nothing happens once it has stopped."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(act)

    def stop(self, goodbye: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Say goodbye to the browsers and stop serving; nothing happens where it has stopped already."""
        if not self._thread.is_alive():
            return
        self.run(goodbye())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_TIMEOUT_S)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            runner, port = self._loop.run_until_complete(self._listen())
        except OSError as error:
            self._started.set_exception(error)
            self._loop.close()
            return
        self._started.set_result(port)
        self._loop.run_forever()
        self._loop.run_until_complete(runner.cleanup())
        self._loop.close()

    async def _listen(self) -> tuple[web.AppRunner, int]:
        app = web.Application()
        app.add_routes([web.get("/", self._page), web.get("/socket", self._talk)])
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        try:
            await web.TCPSite(runner, "127.0.0.1", self._port).start()
        except OSError:
            await runner.cleanup()
            raise
        return runner, int(runner.addresses[0][1])

    def _refuse_foreign_requests(self, request: web.Request) -> None:
        if not secrets.compare_digest(request.query.get("key", ""), self._key):
            raise web.HTTPForbidden(text="This page needs the whole address that the program printed.")

    async def _page(self, request: web.Request) -> web.Response:
        self._refuse_foreign_requests(request)
        return web.Response(text=self._text, content_type="text/html", headers=_HEADERS)

    async def _talk(self, request: web.Request) -> web.WebSocketResponse:
        self._refuse_foreign_requests(request)
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=65536)
        await socket.prepare(request)
        await self._host.joined(socket)
        async for message in socket:
            if message.type is WSMsgType.TEXT and (known := _mapping(message.data)) is not None:
                self._host.received(known)
        self._host.left(socket)
        return socket


def _mapping(text: str) -> Message | None:
    """Return the JSON object in a text; None for anything else: a stranger's nonsense is not answered."""
    try:
        message = parsed_json(text)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None
