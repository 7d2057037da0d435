"""Serves the page that shows patches, and speaks with it: on loopback only, behind a key in its address."""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from concurrent.futures import Future
from importlib.resources import files
from typing import Any, Final

from aiohttp import WSMsgType, web

from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceTimeout

_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
}
_START_TIMEOUT_S: Final = 10.0

Message = dict[str, Any]


class PageServer:
    """An HTTP server in a thread of its own that holds one page at a time.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
    """

    def __init__(self, port: int = 0) -> None:
        self._port, self._key = port, secrets.token_urlsafe(12)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="screen-page", daemon=True)
        self._started: Future[int] = Future()
        self._socket: web.WebSocketResponse | None = None
        self._connected = threading.Event()
        self._waiting: dict[int, Future[Message]] = {}
        self.conditions: Message = {}

    @property
    def url(self) -> str:
        """Return the address to open in a browser. Raises DeviceError unless started."""
        if not self._started.done():
            raise DeviceError("the screen's page is not served yet; open the display first")
        return f"http://127.0.0.1:{self._started.result()}/?key={self._key}"

    def start(self) -> None:
        """Start serving. Raises DeviceInUse where the port is taken."""
        self._thread.start()
        try:
            self._started.result(_START_TIMEOUT_S)
        except OSError as error:
            raise DeviceInUse(
                f"cannot serve the screen's page on port {self._port}: {error.strerror or error}"
            ) from error

    def stop(self) -> None:
        """Tell the page that it is over and stop serving."""
        if not self._thread.is_alive():
            return
        asyncio.run_coroutine_threadsafe(self._say_goodbye(), self._loop).result(_START_TIMEOUT_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_START_TIMEOUT_S)

    def wait_for_page(self, timeout_s: float) -> None:
        """Return once a page is connected. Raises DeviceTimeout."""
        if not self._connected.wait(timeout_s):
            raise DeviceTimeout(
                f"no browser opened {self.url} within {timeout_s:g} s; open it on the screen to be measured"
            )

    def ask(self, message: Message, timeout_s: float) -> Message:
        """Send a message that carries a "sequence" and return the page's answer to it.

        Raises:
            DeviceLost: If no page is connected or it goes away.
            DeviceTimeout: If it does not answer in time.
        """
        answer: Future[Message] = Future()
        self._waiting[message["sequence"]] = answer
        try:
            asyncio.run_coroutine_threadsafe(self._send(message), self._loop).result(timeout_s)
            return answer.result(timeout_s)
        except TimeoutError as error:
            raise DeviceTimeout(
                f"the page did not show the patch within {timeout_s:g} s; is its window visible and not covered?"
            ) from error
        finally:
            self._waiting.pop(message["sequence"], None)

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

    def _refuse_strangers(self, request: web.Request) -> None:
        if not secrets.compare_digest(request.query.get("key", ""), self._key):
            raise web.HTTPForbidden(text="This page needs the whole address that the program printed.")

    async def _page(self, request: web.Request) -> web.Response:
        self._refuse_strangers(request)
        text = files("radiometer.screen.page").joinpath("display.html").read_text(encoding="utf-8")
        return web.Response(text=text, content_type="text/html", headers=_HEADERS)

    async def _talk(self, request: web.Request) -> web.WebSocketResponse:
        self._refuse_strangers(request)
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=65536)
        await socket.prepare(request)
        if self._socket is not None and not self._socket.closed:
            await self._socket.close()
        self._socket = socket
        async for message in socket:
            if message.type is WSMsgType.TEXT:
                self._receive(message.data)
        if self._socket is socket:
            self._lose()
        return socket

    def _receive(self, text: str) -> None:
        try:
            message = json.loads(text)
        except ValueError:
            return
        if not isinstance(message, dict):
            return
        if message.get("kind") in ("hello", "ready", "shown"):
            self.conditions = message
            self._connected.set()
        answer = self._waiting.get(message.get("sequence", -1))
        if message.get("kind") == "shown" and answer is not None and not answer.done():
            answer.set_result(message)

    def _lose(self) -> None:
        self._socket = None
        self._connected.clear()
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(DeviceLost("the page was closed; open its address again and repeat"))

    async def _send(self, message: Message) -> None:
        if self._socket is None or self._socket.closed:
            raise DeviceLost("the page is not connected; open its address again and repeat")
        await self._socket.send_json(message)

    async def _say_goodbye(self) -> None:
        if self._socket is not None and not self._socket.closed:
            await self._socket.send_json({"kind": "end"})
            await self._socket.close()
