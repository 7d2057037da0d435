"""A screen before a subject that is a page in a browser; the button is a key or a touch of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from radiometer.screen.browser_page import BrowserPage, require_shown
from radiometer.screen.loopback import Darken, nothing_to_darken
from radiometer.screen.page_server import PageServer
from radiometer.screen.stimulus import Blink, Hold, Rest, ScreenPicture, Shape

_MARGIN_S: Final = 5.0  # what an answer may take beyond the time that it was asked to wait


class BrowserStimulus(BrowserPage):
    """Shows pictures through the page; what stands on its canvas is read back and compared.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
        announce: Called with the address once it is served; opens a browser or prints it.
        page_timeout_s: How long to wait for a browser to open it.
        start_timeout_s: How long to wait for somebody to press Start; None where nothing is to be waited for.
        darken: Darkens the light box, whoever holds it, for the page's key O; returns what it did in words.
    """

    def __init__(
        self,
        port: int = 0,
        *,
        announce: Callable[[str], None] = lambda url: None,
        page_timeout_s: float = 120.0,
        start_timeout_s: float | None = None,
        darken: Darken = nothing_to_darken,
    ) -> None:
        server = PageServer(port, "stimulus.html", darken)
        super().__init__(server, "the test's page", announce, page_timeout_s, start_timeout_s)

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height of the page in pixels of the screen."""
        seen = self._server.conditions
        return int(seen.get("width", 0)), int(seen.get("height", 0))

    def show(self, picture: ScreenPicture) -> None:
        """Show a picture and return once it is painted. Raises DeviceTimeout, DeviceLost, DeviceError."""
        seen = self._ask({"kind": "show", "field": picture.field, "rest": _shapes(picture)}, _MARGIN_S)["seen"]
        _compare(picture, seen)

    def blink(self, lit: ScreenPicture, rest: ScreenPicture, on_s: float, cycle_s: float) -> Blink:
        """Show `lit`, then `rest`, timed by the page. Raises DeviceTimeout, DeviceLost, DeviceError."""
        order = {"kind": "blink", "field": lit.field, "lit": _shapes(lit), "rest": _shapes(rest)}
        answer = self._ask({**order, "on_ms": 1e3 * on_s, "cycle_ms": 1e3 * cycle_s}, cycle_s + _MARGIN_S)
        _compare(lit, answer["seen"])
        return Blink(
            tuple(1e-3 * float(t) for t in answer["presses_ms"] if t >= 0),
            _hold(answer),
            1e-3 * float(answer["on_ms"]),
            1e-3 * float(answer["frame_ms"]),
            1e-3 * float(answer["longest_frame_ms"]),
        )

    def rest(self, seconds: float) -> Rest:
        """Let time pass and return what was pressed. Raises DeviceTimeout, DeviceLost."""
        answer = self._ask({"kind": "rest", "ms": 1e3 * seconds}, seconds + _MARGIN_S)
        return Rest(int(answer["presses"]), _hold(answer))


def _hold(answer: dict[str, Any]) -> Hold:
    return Hold(1e-3 * float(answer["held_ms"]), 1e-3 * float(answer["held_ago_ms"]))


def _shapes(picture: ScreenPicture) -> list[dict[str, Any]]:
    return [_mapping(shape) for shape in picture.shapes]


def _mapping(shape: Shape) -> dict[str, Any]:
    return {"x": shape.x, "y": shape.y, "width": shape.width, "height": shape.height, "rgb": list(shape.rgb)}


def _compare(picture: ScreenPicture, seen: list[list[int]]) -> None:
    require_shown(seen, [list(picture.field), *(list(shape.rgb) for shape in picture.shapes)])
