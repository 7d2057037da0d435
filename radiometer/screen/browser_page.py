"""A page that somebody opens in a browser: served, waited for, asked, and judged by what it says of itself."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict
from typing import Any, ClassVar, Final

from radiometer.devices import DisplayPatch
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError, DeviceLost, DeviceTimeout, SettingOutOfRange
from radiometer.screen.loopback import Darken, LoopbackServer, Message, nothing_to_darken, page_text
from radiometer.screen.stimulus import Blink, Hold, Rest, ScreenPicture


class BrowserPage(Opened):
    """Serves a page between `open()` and `close()`.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
        announce: Called with the address once it is served; opens a browser or prints it.
        page_timeout_s: How long to wait for a browser to open it.
        start_timeout_s: How long to wait for somebody to press Start; None where nothing is to be waited for.
        show_timeout_s: How long an answer may take, beyond the time that the page was asked to wait.
        darken: Darkens the light box, whoever holds it, for the page's key O; returns what it did in words.
    """

    _page: ClassVar[str]  # its file
    _what: ClassVar[str]  # what it is, for messages

    def __init__(
        self,
        port: int = 0,
        *,
        announce: Callable[[str], None] = lambda url: None,
        page_timeout_s: float = 120.0,
        start_timeout_s: float | None = None,
        show_timeout_s: float = 5.0,
        darken: Darken = nothing_to_darken,
    ) -> None:
        text, self._announce, self._darken = page_text(self._page), announce, darken
        self._server = LoopbackServer(text, self, port, what=self._what, only_newest=True)
        self._page_timeout_s, self._start_timeout_s = page_timeout_s, start_timeout_s
        self._show_timeout_s = show_timeout_s
        self._connected, self._begun = threading.Event(), threading.Event()
        self._answers: dict[int, Future[Message]] = {}
        self._numbers = itertools.count(1)
        self._conditions: Message = {}
        self._open = False

    @property
    def url(self) -> str:
        """Return the address of the page. Raises DeviceError unless open."""
        return self._server.url

    @property
    def acknowledged(self) -> dict[str, Any]:
        """Return what the page last reported of itself, such as its size, its zoom and what it read back."""
        return dict(self._conditions)

    def open(self) -> None:
        """Serve the page and wait until a browser has opened it. Raises DeviceInUse, DeviceTimeout, DeviceError."""
        if self._open:
            raise DeviceError(f"{self._what} is served already; close it first")
        self._server.start()
        self._open = True
        self._announce(self.url)
        try:
            if not self._connected.wait(self._page_timeout_s):
                raise DeviceTimeout(
                    f"no browser opened {self.url} within {self._page_timeout_s:g} s; "
                    "open it on the screen to be measured"
                )
            if self._start_timeout_s is not None and not self._begun.wait(self._start_timeout_s):
                raise DeviceTimeout(
                    f"Start was not pressed on {self.url} within {self._start_timeout_s:g} s; press it and repeat"
                )
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        if self._open:
            self._open = False
            self._server.stop({"kind": "end"})

    def warnings(self) -> list[str]:
        """Return what on the page's side may falsify what is shown."""
        return page_warnings(self._conditions)

    def greeting(self) -> None:
        """Return None: the page itself begins."""

    def received(self, message: Message) -> None:
        """Note what the page says of itself, and hand an answer to who waits for it."""
        kind, number = message.get("kind"), message.get("sequence")
        if kind in ("hello", "ready", "shown"):
            self._conditions = message
            self._connected.set()
            if kind == "ready" or message.get("fullscreen"):
                self._begun.set()
        if kind == "lights_off":
            self._server.darken(self._darken)
        answer = self._answers.get(number) if isinstance(number, int) else None
        if kind == "shown" and answer is not None and not answer.done():
            answer.set_result(message)

    def left(self) -> None:
        """End the wait of whoever waits for an answer: the page is gone."""
        if self._server.is_shown:
            return
        self._connected.clear()
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(DeviceLost("the page was closed; open its address again and repeat"))

    def _ask(self, order: Mapping[str, Any], lasting_s: float = 0.0) -> Message:
        """Return the page's answer to an order that lasts some time. Raises DeviceTimeout, DeviceLost, DeviceError."""
        number, timeout_s = next(self._numbers), lasting_s + self._show_timeout_s
        answer: Future[Message] = Future()
        self._answers[number] = answer
        try:
            self._server.run(self._send({**order, "sequence": number}), timeout_s)
            return answer.result(timeout_s)
        except TimeoutError as error:
            raise DeviceTimeout(
                f"the page did not show the patch within {timeout_s:g} s; is its window visible and not covered?"
            ) from error
        finally:
            del self._answers[number]

    async def _send(self, message: Message) -> None:
        if not self._server.is_shown:
            raise DeviceLost("the page is not connected; open its address again and repeat")
        await self._server.send_all(message)


def page_warnings(seen: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with a page by what it says of itself."""
    checks = (
        (not seen.get("fullscreen", False), "the page is not full screen: press F11"),
        (seen.get("zoom", 1) != 1, "the page is zoomed in: reset it to 100 %"),
        (float(seen.get("pixelRatio", 1)) % 1 != 0, "page or desktop is zoomed to parts of pixels: set both to 100 %"),
        (seen.get("hdr", False), "the screen runs in HDR: its levels are mapped before they are shown"),
        (seen.get("forcedColours", False), "high-contrast colours are on"),
        (not seen.get("visible", True), "the page is hidden behind another window"),
        (seen.get("colourDepth", 24) < 24, "the screen shows fewer than 8 bits per channel"),
    )
    return [text for wrong, text in checks if wrong]


def require_shown(seen: object, expected: object) -> None:
    """Raise DeviceError unless the page read back the levels that it was sent."""
    if seen != expected:
        raise DeviceError(
            f"the browser shows {seen} where {expected} was asked for; switch off colour filters, "
            "dark-mode extensions and forced colours"
        )


_LEVELS: Final = 255  # a canvas holds 8 bits per channel


class BrowserStimulus(BrowserPage):
    """Shows pictures through the page; what stands on its canvas is read back and compared."""

    _page, _what = "stimulus.html", "the test's page"

    @property
    def size(self) -> tuple[int, int]:
        seen = self._conditions
        return int(seen.get("width", 0)), int(seen.get("height", 0))

    def show(self, picture: ScreenPicture) -> None:
        seen = self._ask({"kind": "show", "field": picture.field, "rest": _shapes(picture)})["seen"]
        _compare(picture, seen)

    def blink(self, lit: ScreenPicture, rest: ScreenPicture, on_s: float, cycle_s: float) -> Blink:
        order = {"kind": "blink", "field": lit.field, "lit": _shapes(lit), "rest": _shapes(rest)}
        answer = self._ask({**order, "on_ms": 1e3 * on_s, "cycle_ms": 1e3 * cycle_s}, cycle_s)
        _compare(lit, answer["seen"])
        return Blink(
            tuple(1e-3 * float(t) for t in answer["presses_ms"] if t >= 0),
            _hold(answer),
            1e-3 * float(answer["on_ms"]),
            1e-3 * float(answer["frame_ms"]),
        )

    def rest(self, seconds: float) -> Rest:
        answer = self._ask({"kind": "rest", "ms": 1e3 * seconds}, seconds)
        return Rest(int(answer["presses"]), _hold(answer))


def _hold(answer: dict[str, Any]) -> Hold:
    return Hold(1e-3 * float(answer["held_ms"]), 1e-3 * float(answer["held_ago_ms"]))


def _shapes(picture: ScreenPicture) -> list[dict[str, Any]]:
    return [asdict(shape) for shape in picture.shapes]


def _compare(picture: ScreenPicture, seen: list[list[int]]) -> None:
    require_shown(seen, [list(picture.field), *(list(shape.rgb) for shape in picture.shapes)])


class BrowserDisplay(BrowserPage):
    """Shows patches through the page; every patch is acknowledged after it was painted, and read back."""

    _page, _what = "display.html", "the screen's page"

    def show(self, patch: DisplayPatch) -> None:
        """Show a patch and return once the browser has painted it.

        Raises:
            SettingOutOfRange: If a drive is not between 0 and 1.
            DeviceTimeout: If the page does not answer.
            DeviceLost: If it was closed.
            DeviceError: If it shows another level than asked for.
        """
        expected = _codes(patch.rgb)
        order = {
            "kind": "show",
            "rgb": expected,
            "surround": _codes(patch.surround_rgb),
            "width": _fraction("width", patch.width_fraction),
            "height": _fraction("height", patch.height_fraction),
            "checkers": patch.checkers,
        }
        require_shown(self._ask(order).get("rgb"), expected)


def _codes(rgb: tuple[float, float, float]) -> list[int]:
    for name, drive in zip(("red", "green", "blue"), rgb, strict=True):
        if not 0.0 <= drive <= 1.0:
            raise SettingOutOfRange("screen", f"{name} drive", drive, 0.0, 1.0, "")
    return [round(drive * _LEVELS) for drive in rgb]


def _fraction(name: str, value: float) -> float:
    if not 0.0 < value <= 1.0:
        raise SettingOutOfRange("screen", f"patch {name}", value, 0.0, 1.0, "of the screen")
    return value
