"""Serves one page on loopback only, behind a key in its address, and holds a socket to each browser that shows it."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from importlib.resources import files
from typing import Any, Final, Protocol, TypeVar

from aiohttp import WSMsgType, web

from radiometer.data.json_text import parsed_json
from radiometer.errors import DeviceError, DeviceInUse, RadiometerError
from radiometer.reporting.server_log import logger_of_server

_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
}
_TIMEOUT_S: Final = 10.0  # loopback takes ms; a machine that swaps takes seconds
_SLOW_BROWSER_S: Final = 2.0  # a browser that takes longer is asleep

Message = dict[str, Any]
Darken = Callable[[], str]
Result = TypeVar("Result")


def nothing_to_darken() -> str:
    """Return what a page says that was given no way to a light box."""
    return "this page knows of no light box"


class Host(Protocol):
    """Who talks with the browsers; called on the server's own thread."""

    def greeting(self) -> Message | None:
        """Return what is sent to a browser that has just connected; None for nothing."""

    def received(self, message: Message) -> None:
        """Take a message of a browser."""

    def left(self) -> None:
        """Take note that a browser has gone."""


class LoopbackServer:
    """An HTTP server in a separate thread, on 127.0.0.1; a browser that goes away, or is slow, does no harm.

    Args:
        port: Port; 0 for any free one.
        what: What it serves, for messages.
        only_newest: Let one browser at a time show the page, the newest.
    """

    def __init__(self, page: str, host: Host, port: int = 0, *, what: str = "page", only_newest: bool = False) -> None:
        self._text, self._host, self._port, self._what, self._only_newest = page, host, port, what, only_newest
        self._sockets: set[web.WebSocketResponse] = set()
        self._tasks: set[asyncio.Task[None]] = set()
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

    @property
    def is_shown(self) -> bool:
        """Return whether a browser shows the page; to be asked on the server's thread."""
        return any(not socket.closed for socket in self._sockets)

    async def send_all(self, message: Message) -> None:
        """Send a message to every browser, and drop those that do not take it."""
        await asyncio.gather(*(self._send(socket, message) for socket in tuple(self._sockets)))

    def keep(self, work: Coroutine[Any, Any, None]) -> None:
        """Have work done on the server's thread, which calls this, without waiting for it."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def darken(self, darken: Darken) -> None:
        """Darken the light box, however long it takes, and report the outcome to the browsers; called as `keep`."""

        async def report() -> None:
            try:
                outcome = await asyncio.to_thread(darken)
            except RadiometerError as error:
                outcome = f"not dark: {error}"
            await self.send_all({"kind": "outcome", "text": outcome})

        self.keep(report())

    def stop(self, goodbye: Message) -> None:
        """Say goodbye to the browsers and stop serving; nothing happens where it has stopped already."""
        if not self._thread.is_alive():
            return
        self.run(self._part(goodbye))
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_TIMEOUT_S)

    async def _send(self, socket: web.WebSocketResponse, message: Message) -> None:
        try:
            async with asyncio.timeout(_SLOW_BROWSER_S):
                await socket.send_json(message)
        except (ConnectionError, RuntimeError, TimeoutError):
            self._sockets.discard(socket)

    async def _part(self, goodbye: Message) -> None:
        await self.send_all(goodbye)
        for socket in tuple(self._sockets):
            with contextlib.suppress(ConnectionError, RuntimeError):
                await socket.close()

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
        runner = web.AppRunner(app, access_log=None, logger=logger_of_server(__name__), shutdown_timeout=1.0)
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
        others, self._sockets = self._sockets, {socket} if self._only_newest else {*self._sockets, socket}
        for other in others - self._sockets:
            await other.close()
        if (greeting := self._host.greeting()) is not None:
            await self._send(socket, greeting)
        async for message in socket:
            if message.type is WSMsgType.TEXT and (known := _mapping(message.data)) is not None:
                self._host.received(known)
        self._sockets.discard(socket)
        self._host.left()
        return socket


def _mapping(text: str) -> Message | None:
    """Return the JSON object in a text; None for anything else: a stranger's nonsense is not answered."""
    try:
        message = parsed_json(text)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None


_COMMON: Final = "/* common.js */"


def page_text(name: str) -> str:
    """Return a page of this package, with the script that all of them share put in."""
    folder = files("radiometer.screen.page")
    text = folder.joinpath(name).read_text(encoding="utf-8")
    return text.replace(_COMMON, folder.joinpath("common.js").read_text(encoding="utf-8"))
