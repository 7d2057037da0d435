"""A screen before a subject that is a page in a browser; the button is a key or a touch of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, Self

from radiometer.errors import DeviceError
from radiometer.screen.browser_display import page_warnings
from radiometer.screen.page_server import PageServer
from radiometer.screen.stimulus import Blink, Hold, Picture, Rest, Shape

_MARGIN_S: Final = 5.0  # what an answer may take beyond the time that it was asked to wait


class BrowserStimulus:
    """Shows pictures through the page; what stands on its canvas is read back and compared.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
        announce: Called with the address once it is served; opens a browser or prints it.
        page_timeout_s: How long to wait for a browser to open it.
        start_timeout_s: How long to wait for somebody to press Start; None where nothing is to be waited for.
    """

    def __init__(
        self,
        port: int = 0,
        *,
        announce: Callable[[str], None] = lambda url: None,
        page_timeout_s: float = 120.0,
        start_timeout_s: float | None = None,
    ) -> None:
        self._server = PageServer(port, "stimulus.html")
        self._announce, self._page_timeout_s, self._start_timeout_s = announce, page_timeout_s, start_timeout_s
        self._numbers = itertools.count(1)
        self._open = False

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height of the page in pixels of the screen."""
        seen = self._server.conditions
        return int(seen.get("width", 0)), int(seen.get("height", 0))

    @property
    def acknowledged(self) -> dict[str, Any]:
        """Return what the page last said."""
        return dict(self._server.conditions)

    def open(self) -> None:
        """Serve the page and wait until a browser has opened it. Raises DeviceInUse, DeviceTimeout, DeviceError."""
        if self._open:
            raise DeviceError("the test's page is served already; close it first")
        self._server.start()
        self._open = True
        self._announce(self._server.url)
        try:
            self._server.wait_for_page(self._page_timeout_s)
            if self._start_timeout_s is not None:
                self._server.wait_for_start(self._start_timeout_s)
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Stop serving; closing twice does nothing."""
        if self._open:
            self._open = False
            self._server.stop()

    def show(self, picture: Picture) -> None:
        """Show a picture and return once it is painted. Raises DeviceTimeout, DeviceLost, DeviceError."""
        seen = self._ask({"kind": "show", "field": picture.field, "rest": _shapes(picture)}, 0.0)["seen"]
        _compare(picture, seen)

    def blink(self, lit: Picture, rest: Picture, on_s: float, cycle_s: float) -> Blink:
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

    def warnings(self) -> list[str]:
        """Return what on the page's side may falsify a test."""
        return page_warnings(self._server.conditions)

    def _ask(self, order: dict[str, Any], takes_s: float) -> dict[str, Any]:
        return self._server.ask({**order, "sequence": next(self._numbers)}, takes_s + _MARGIN_S)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _hold(answer: dict[str, Any]) -> Hold:
    return Hold(1e-3 * float(answer["held_ms"]), 1e-3 * float(answer["held_ago_ms"]))


def _shapes(picture: Picture) -> list[dict[str, Any]]:
    return [_mapping(shape) for shape in picture.shapes]


def _mapping(shape: Shape) -> dict[str, Any]:
    return {"x": shape.x, "y": shape.y, "width": shape.width, "height": shape.height, "rgb": list(shape.rgb)}


def _compare(picture: Picture, seen: list[list[int]]) -> None:
    wanted = [list(picture.field), *(list(shape.rgb) for shape in picture.shapes)]
    if seen != wanted:
        raise DeviceError(
            f"the browser shows {seen} where {wanted} was asked for; switch off colour filters, "
            "dark-mode extensions and forced colours"
        )
