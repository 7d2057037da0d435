"""Holds the page that shows patches or spots, and asks it to show them."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import Future
from importlib.resources import files
from typing import Final

from aiohttp import web

from radiometer.errors import DeviceLost, DeviceTimeout
from radiometer.screen.loopback import Darken, LoopbackServer, Message, darkened

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
