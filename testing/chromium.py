"""Headless Chromium over its debugging socket, for tests of pages."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import io
import queue
import re
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Protocol

import aiohttp
import numpy as np
import pytest
from PIL import Image

from testing.patience import within

_CHROMIUM_FLAGS = (
    "headless",
    "no-sandbox",
    "disable-gpu",
    "disable-background-networking",
    "disable-component-update",
    "disable-sync",
    "no-first-run",
    "disable-quic",
    "force-color-profile=srgb",
    "hide-scrollbars",
    "remote-debugging-port=0",
)


class Browser:
    """Headless Chromium over its debugging socket."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket, self._number = socket, 0
        self.requested: list[str] = []
        self.errors: list[str] = []

    async def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Run a command and return its result."""
        self._number += 1
        await self._socket.send_json({"id": self._number, "method": method, "params": parameters})
        async with asyncio.timeout(within(20.0)):
            while True:
                message = await self._socket.receive_json()
                self._note(message)
                if message.get("id") == self._number:
                    return dict(message["result"])

    async def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = await self.command("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        return result["result"].get("value")

    async def wait_for(self, expression: str, deadline_s: float = 20.0) -> Any:
        """Return the value of an expression once it is true."""
        async with asyncio.timeout(within(deadline_s)):
            while not (value := await self.evaluate(expression)):
                await asyncio.sleep(0.1)
            return value

    async def mouse(self, kind: str, x: float, y: float) -> None:
        """Move, press or release the left button."""
        await self.command("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    async def key(self, kind: str, code: str = "Space", key: str = " ") -> None:
        """Press ("keyDown") or release ("keyUp") a key."""
        await self.command("Input.dispatchKeyEvent", type=kind, code=code, key=key)

    async def be_a_phone(self, width: int, height: int) -> None:
        """Show pages as a phone of a size in CSS pixels does."""
        await self.command(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=2, mobile=True
        )

    async def picture(self) -> np.ndarray:
        """Return what the browser composes for its screen, shape (height, width, 3)."""
        shot = await self.command("Page.captureScreenshot", format="png")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB"))

    def _note(self, message: dict[str, Any]) -> None:
        if message.get("method") == "Network.requestWillBeSent":
            self.requested.append(message["params"]["request"]["url"])
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(message["params"]["exceptionDetails"]))
        if message.get("method") == "Log.entryAdded" and message["params"]["entry"]["level"] == "error":
            self.errors.append(str(message["params"]["entry"]))
        if message.get("method") == "Runtime.consoleAPICalled" and message["params"]["type"] in ("error", "assert"):
            self.errors.append(str(message["params"]["args"]))


class Page(Protocol):
    """A display or stimulus that a browser shows, its address announced into a queue when it is opened."""

    def open(self) -> None:
        """Wait until the page is there."""

    def close(self) -> None:
        """End it."""


@asynccontextmanager
async def shows(browser: Browser, page: Page, addresses: queue.SimpleQueue[str], *, start: bool) -> AsyncIterator[None]:
    """Have a browser show a page for the block, its Start pressed where it has one."""
    opening = asyncio.create_task(asyncio.to_thread(page.open))
    await browser.command("Page.navigate", url=await asyncio.to_thread(addresses.get))
    if start:
        await browser.wait_for("document.getElementById('state').textContent === 'connected'")
        await browser.evaluate("document.getElementById('go').click()")
    await opening
    try:
        yield
    finally:
        await asyncio.to_thread(page.close)


@asynccontextmanager
async def headless(profile: Path, window: tuple[int, int] = (1240, 900)) -> AsyncIterator[Browser]:
    """Start a browser with an empty profile for the block; skip the test where there is none."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("chromium is not installed")
    flags = [*(f"--{name}" for name in _CHROMIUM_FLAGS), f"--window-size={window[0]},{window[1]}"]
    process = await asyncio.create_subprocess_exec(
        program, *flags, f"--user-data-dir={profile}", "about:blank",
        stderr=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    assert process.stderr is not None
    async with asyncio.timeout(60):
        while not (found := re.search(rb"ws://127\.0\.0\.1:(\d+)/", await process.stderr.readline())):
            pass
    drained = asyncio.create_task(process.stderr.read())
    try:
        async with aiohttp.ClientSession() as http:
            async with http.get(f"http://127.0.0.1:{int(found[1])}/json") as reply:
                tabs = await reply.json(content_type=None)
            address = next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
            async with http.ws_connect(address, max_msg_size=0) as socket:
                driver = Browser(socket)
                for domain in ("Page", "Runtime", "Network", "Log"):
                    await driver.command(f"{domain}.enable")
                yield driver
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        await process.wait()
        await drained
