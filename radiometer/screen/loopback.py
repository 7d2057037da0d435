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
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceTimeout, RadiometerError
from radiometer.reporting.server_log import logger_of_server

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


_COMMON: Final = "/* common.js */"


def page_text(name: str) -> str:
    """Return a page of this package, with the script that all of them share put in."""
    folder = files("radiometer.screen.page")
    text = folder.joinpath(name).read_text(encoding="utf-8")
    return text.replace(_COMMON, folder.joinpath("common.js").read_text(encoding="utf-8"))


class PageServer:
    """A served page that one browser at a time shows: the newest.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
        darken: Darkens the light box, whoever holds it, and returns what it did in words; called on its own thread.
    """

    def __init__(self, port: int, page: str, darken: Darken) -> None:
        self._server = LoopbackServer(page_text(page), self, port, what="screen's page")
        self._socket: web.WebSocketResponse | None = None
        self._connected, self._begun = threading.Event(), threading.Event()
        self._waiting: dict[int, Future[Message]] = {}
        self._darken, self._darkening = darken, set[asyncio.Task[None]]()
        self.conditions: Message = {}

    @property
    def url(self) -> str:
        """Return the address to open in a browser. Raises DeviceError unless started."""
        return self._server.url

    def start(self) -> None:
        """Start serving. Raises DeviceInUse where the port is taken."""
        self._server.start()

    def stop(self) -> None:
        """Tell the page that it is over and stop serving."""
        self._server.stop(self._say_goodbye)

    def wait_for_page(self, timeout_s: float) -> None:
        """Return once a page is connected. Raises DeviceTimeout."""
        if not self._connected.wait(timeout_s):
            raise DeviceTimeout(
                f"no browser opened {self.url} within {timeout_s:g} s; open it on the screen to be measured"
            )

    def wait_for_start(self, timeout_s: float) -> None:
        """Return once somebody has pressed Start, or the page fills the screen already. Raises DeviceTimeout."""
        if not self._begun.wait(timeout_s):
            raise DeviceTimeout(f"Start was not pressed on {self.url} within {timeout_s:g} s; press it and repeat")

    def ask(self, message: Message, timeout_s: float) -> Message:
        """Send a message that carries a "sequence" and return the page's answer to it.

        Raises:
            DeviceLost: If no page is connected or it goes away.
            DeviceTimeout: If it does not answer in time.
        """
        answer: Future[Message] = Future()
        self._waiting[message["sequence"]] = answer
        try:
            self._server.run(self._send(message), timeout_s)
            return answer.result(timeout_s)
        except TimeoutError as error:
            raise DeviceTimeout(
                f"the page did not show the patch within {timeout_s:g} s; is its window visible and not covered?"
            ) from error
        finally:
            self._waiting.pop(message["sequence"], None)

    async def joined(self, socket: web.WebSocketResponse) -> None:
        """Take a browser in place of the one before."""
        if self._socket is not None and not self._socket.closed:
            await self._socket.close()
        self._socket = socket

    def received(self, message: Message) -> None:
        """Note what the page says of itself, and hand an answer to who waits for it."""
        if message.get("kind") in ("hello", "ready", "shown"):
            self.conditions = message
            self._connected.set()
            if message.get("kind") == "ready" or message.get("fullscreen"):
                self._begun.set()
        if message.get("kind") == "lights_off":
            task = asyncio.get_running_loop().create_task(self._lights_off())
            self._darkening.add(task)
            task.add_done_callback(self._darkening.discard)
        number = message.get("sequence")
        answer = self._waiting.get(number) if isinstance(number, int) else None
        if message.get("kind") == "shown" and answer is not None and not answer.done():
            answer.set_result(message)

    def left(self, socket: web.WebSocketResponse) -> None:
        """Tell who waits for an answer that the page is gone."""
        if self._socket is not socket:
            return
        self._socket = None
        self._connected.clear()
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(DeviceLost("the page was closed; open its address again and repeat"))

    async def _send(self, message: Message) -> None:
        if self._socket is None or self._socket.closed:
            raise DeviceLost("the page is not connected; open its address again and repeat")
        await self._socket.send_json(message)

    async def _lights_off(self) -> None:
        outcome = await darkened(self._darken)
        with contextlib.suppress(DeviceLost, ConnectionError):
            await self._send(outcome)

    async def _say_goodbye(self) -> None:
        if self._socket is not None and not self._socket.closed:
            await self._socket.send_json({"kind": "end"})
            await self._socket.close()
