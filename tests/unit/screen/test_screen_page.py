"""The page's server and its Display: who may speak to it, what is acknowledged, what is refused."""

import asyncio
import json
import logging
import queue
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from logging.handlers import BufferingHandler

import aiohttp
import pytest

from radiometer.devices import Display, DisplayPatch
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceTimeout, SettingOutOfRange
from radiometer.screen.browser_page import BrowserDisplay
from radiometer.screen.loopback import page_text
from testing.patience import within

Answer = Callable[[dict], dict | None]


def _echo(order: dict) -> dict:
    return {"kind": "shown", "sequence": order["sequence"], "rgb": order["rgb"], "fullscreen": True}


class FakePage:
    """A page that connects in a thread and answers orders as it is asked to."""

    def __init__(self, answer: Answer = _echo, hello: tuple[str, ...] = ("hello",)) -> None:
        self.orders: list[dict] = []
        self._answer, self._hello = answer, hello
        self._thread: threading.Thread | None = None

    def open(self, url: str) -> None:
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run(url)), daemon=True)
        self._thread.start()

    def join(self) -> None:
        if self._thread:
            self._thread.join(within(10.0))

    async def _run(self, url: str) -> None:
        address = url.replace("/?", "/socket?")
        async with aiohttp.ClientSession() as session, session.ws_connect(address) as socket:
            for kind in self._hello:
                await socket.send_json({"kind": kind, "fullscreen": False, "zoom": 1})
            async for message in socket:
                order = json.loads(message.data)
                self.orders.append(order)
                if order["kind"] == "end":
                    return
                answer = self._answer(order)
                if answer is None:
                    return
                await socket.send_json(answer)


@pytest.fixture
def shown() -> Iterator[tuple[BrowserDisplay, FakePage]]:
    """Return an open display with a page that obeys."""
    page = FakePage()
    with BrowserDisplay(announce=page.open, page_timeout_s=10) as display:
        yield display, page
    page.join()


def test_patch_reaches_the_page_as_codes(shown: tuple[BrowserDisplay, FakePage]) -> None:
    """Drives become the nearest of 256 codes; size and surround go with them; that it fills the screen is seen."""
    display, page = shown
    assert isinstance(display, Display)
    assert any("full screen" in line for line in display.warnings())
    display.show(DisplayPatch((1.0, 0.5, 0.0), (0.2, 0.2, 0.2), 0.5, 0.25))
    assert not any("full screen" in line for line in display.warnings())
    order = page.orders[-1]
    assert order["rgb"] == [255, 128, 0]
    assert order["surround"] == [51, 51, 51]
    assert (order["width"], order["height"]) == (0.5, 0.25)


def test_every_level_is_acknowledged(shown: tuple[BrowserDisplay, FakePage]) -> None:
    """All 256 levels are answered in order, each with its own number; the last order is the end."""
    display, page = shown
    for level in range(256):
        display.show(DisplayPatch((level / 255,) * 3))
    assert [o["rgb"][0] for o in page.orders] == list(range(256))
    assert len({o["sequence"] for o in page.orders}) == 256
    display.close()
    page.join()
    assert page.orders[-1] == {"kind": "end"}


@pytest.mark.parametrize(
    ("answer", "timeout_s", "error", "message"),
    [
        (lambda order: {**_echo(order), "rgb": [254, 250, 230]}, 30.0, DeviceError, r"shows \[254, 250, 230\]"),
        (lambda order: {**_echo(order), "sequence": -5}, 0.2, DeviceTimeout, r"within 0\.2 s"),
        (lambda order: None, 30.0, DeviceLost, None),
    ],
    ids=["night colours in the browser", "an answer to another order", "closed"],
)
def test_a_page_that_does_not_show_what_it_was_sent_is_an_error(answer, timeout_s, error, message) -> None:
    """What it paints, or that it did not answer; where the page goes, at once and not at the end of the limit."""
    page = FakePage(answer)
    with BrowserDisplay(announce=page.open, show_timeout_s=timeout_s) as display, pytest.raises(error, match=message):
        display.show(DisplayPatch((1, 1, 1)))


def test_no_browser_is_a_timeout_that_repeats_the_address() -> None:
    """The user gets the address to open; a page whose Start no one presses is no reason to begin, pressing it is."""
    display = BrowserDisplay(page_timeout_s=0.1)
    with pytest.raises(DeviceTimeout, match=r"http://127\.0\.0\.1:\d+/\?key="):
        display.open()
    waiting = FakePage()
    display = BrowserDisplay(announce=waiting.open, page_timeout_s=10, start_timeout_s=0.2)
    with pytest.raises(DeviceTimeout, match="Start was not pressed"):
        display.open()
    pressed = FakePage(hello=("hello", "ready"))
    with BrowserDisplay(announce=pressed.open, page_timeout_s=10, start_timeout_s=10) as begun:
        begun.show(DisplayPatch((1, 1, 1)))
    assert pressed.orders[0]["rgb"] == [255, 255, 255]


@pytest.mark.parametrize("request_head", ["POST / HTTP/1.1\r\nContent-Length: -5", f"GET /{'a' * 100_000} HTTP/1.1"])
def test_nonsense_of_another_program_is_refused_in_silence(request_head: str) -> None:
    """It has its 400, and the operator's terminal stays as it is."""
    logged = BufferingHandler(100)
    logging.getLogger().addHandler(logged)
    with BrowserDisplay(announce=FakePage().open, page_timeout_s=10) as display:
        port = int(display.url.split(":")[2].split("/")[0])
        with socket.create_connection(("127.0.0.1", port), 10.0) as client:
            client.sendall(f"{request_head}\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            assert b" 400 " in client.recv(1000)
    logging.getLogger().removeHandler(logged)
    assert [record.getMessage() for record in logged.buffer] == []


def test_page_is_served_whole_to_who_has_the_key(shown: tuple[BrowserDisplay, FakePage]) -> None:
    """One file, uncached, nothing from elsewhere; without the key neither page nor socket; a taken port is named."""
    url = shown[0].url
    bare = url.split("?")[0]
    for address in (bare, bare + "socket?key=wrong"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(address, timeout=within(5))
        assert refused.value.code == 403
        refused.value.close()
    with urllib.request.urlopen(url, timeout=within(5)) as answer:
        text = answer.read().decode()
        assert answer.headers["Cache-Control"] == "no-store"
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert "requestAnimationFrame" in text
    assert "http://" not in text.replace("ws://", "")
    port = int(url.split(":")[2].split("/")[0])
    with pytest.raises(DeviceInUse, match=str(port)):
        BrowserDisplay(port).open()


@pytest.mark.parametrize("patch", [DisplayPatch((1.1, 0, 0)), DisplayPatch((1, 1, 1), width_fraction=0.0)])
def test_impossible_patches_are_refused(shown: tuple[BrowserDisplay, FakePage], patch: DisplayPatch) -> None:
    """Nothing is sent."""
    display, page = shown
    with pytest.raises(SettingOutOfRange):
        display.show(patch)
    assert page.orders == []


async def test_lights_off_of_a_screen_page_darkens_the_box() -> None:
    """Its key reaches whoever holds the box, also while a picture stands on the screen; the page is reported."""
    asked = threading.Event()

    def darken() -> str:
        asked.set()
        return "dark: light box AAAA0001"

    addresses = queue.SimpleQueue[str]()
    display = BrowserDisplay(announce=addresses.put, darken=darken)
    opening = asyncio.create_task(asyncio.to_thread(display.open))
    address = (await asyncio.to_thread(addresses.get)).replace("/?", "/socket?")
    async with aiohttp.ClientSession() as session, session.ws_connect(address) as socket:
        await socket.send_json({"kind": "hello"})
        await socket.send_json({"kind": "lights_off"})
        assert json.loads((await socket.receive(timeout=within(20))).data) == {
            "kind": "outcome",
            "text": "dark: light box AAAA0001",
        }
    assert asked.is_set()
    await opening
    await asyncio.to_thread(display.close)


@pytest.mark.parametrize("page", ["display.html", "stimulus.html"])
def test_every_screen_page_has_lights_off(page: str) -> None:
    """A button before the start, and the key O at any time."""
    text = page_text(page)
    assert 'id="dark"' in text
    assert '"KeyO"' in text
