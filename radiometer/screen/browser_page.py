"""A page that somebody opens in a browser: served, waited for, asked, and judged by what it says of itself."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError
from radiometer.screen.loopback import Darken, nothing_to_darken
from radiometer.screen.page_server import PageServer


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
        self._server, self._announce = PageServer(port, self._page, darken), announce
        self._page_timeout_s, self._start_timeout_s = page_timeout_s, start_timeout_s
        self._show_timeout_s = show_timeout_s
        self._numbers = itertools.count(1)
        self._open = False

    @property
    def url(self) -> str:
        """Return the address of the page. Raises DeviceError unless open."""
        return self._server.url

    @property
    def acknowledged(self) -> dict[str, Any]:
        """Return what the page last reported of itself, such as its size, its zoom and what it read back."""
        return dict(self._server.conditions)

    def open(self) -> None:
        """Serve the page and wait until a browser has opened it. Raises DeviceInUse, DeviceTimeout, DeviceError."""
        if self._open:
            raise DeviceError(f"{self._what} is served already; close it first")
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

    def warnings(self) -> list[str]:
        """Return what on the page's side may falsify what is shown."""
        return page_warnings(self._server.conditions)

    def _ask(self, order: Mapping[str, Any], lasting_s: float = 0.0) -> dict[str, Any]:
        """Return the page's answer to an order that lasts some time. Raises DeviceTimeout, DeviceLost, DeviceError."""
        return self._server.ask({**order, "sequence": next(self._numbers)}, lasting_s + self._show_timeout_s)


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
