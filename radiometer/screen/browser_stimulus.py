"""A screen before a subject that is a page in a browser; the button is a key or a touch of it."""

from __future__ import annotations

from typing import Any

from radiometer.screen.browser_page import BrowserPage, require_shown
from radiometer.screen.stimulus import Blink, Hold, Rest, ScreenPicture, Shape


class BrowserStimulus(BrowserPage):
    """Shows pictures through the page; what stands on its canvas is read back and compared."""

    _page, _what = "stimulus.html", "the test's page"

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height of the page in pixels of the screen."""
        seen = self._server.conditions
        return int(seen.get("width", 0)), int(seen.get("height", 0))

    def show(self, picture: ScreenPicture) -> None:
        """Show a picture and return once it is painted. Raises DeviceTimeout, DeviceLost, DeviceError."""
        seen = self._ask({"kind": "show", "field": picture.field, "rest": _shapes(picture)})["seen"]
        _compare(picture, seen)

    def blink(self, lit: ScreenPicture, rest: ScreenPicture, on_s: float, cycle_s: float) -> Blink:
        """Show `lit`, then `rest`, timed by the page. Raises DeviceTimeout, DeviceLost, DeviceError."""
        order = {"kind": "blink", "field": lit.field, "lit": _shapes(lit), "rest": _shapes(rest)}
        answer = self._ask({**order, "on_ms": 1e3 * on_s, "cycle_ms": 1e3 * cycle_s}, cycle_s)
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
        answer = self._ask({"kind": "rest", "ms": 1e3 * seconds}, seconds)
        return Rest(int(answer["presses"]), _hold(answer))


def _hold(answer: dict[str, Any]) -> Hold:
    return Hold(1e-3 * float(answer["held_ms"]), 1e-3 * float(answer["held_ago_ms"]))


def _shapes(picture: ScreenPicture) -> list[dict[str, Any]]:
    return [_mapping(shape) for shape in picture.shapes]


def _mapping(shape: Shape) -> dict[str, Any]:
    return {"x": shape.x, "y": shape.y, "width": shape.width, "height": shape.height, "rgb": list(shape.rgb)}


def _compare(picture: ScreenPicture, seen: list[list[int]]) -> None:
    require_shown(seen, [list(picture.field), *(list(shape.rgb) for shape in picture.shapes)])
