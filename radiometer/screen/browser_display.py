"""A Display that is a page in a browser: any screen that can open an address."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Final, Self

from radiometer.devices import DisplayPatch
from radiometer.errors import DeviceError, SettingOutOfRange
from radiometer.screen.page_server import PageServer

_LEVELS: Final = 255  # a canvas holds 8 bits per channel


class BrowserDisplay:
    """Shows patches through the page; every patch is acknowledged after it was painted, and read back.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
        announce: Called with the address once it is served; opens a browser or prints it.
        page_timeout_s: How long to wait for a browser to open it.
        start_timeout_s: How long to wait for somebody to press Start; None where nothing is to be waited for.
        show_timeout_s: How long a patch may take to appear.
    """

    def __init__(
        self,
        port: int = 0,
        *,
        announce: Callable[[str], None] = lambda url: None,
        page_timeout_s: float = 120.0,
        start_timeout_s: float | None = None,
        show_timeout_s: float = 5.0,
    ) -> None:
        self._server = PageServer(port)
        self._announce = announce
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
        """Return what the page last said of itself: size, zoom, full screen, and the drive it read back."""
        return dict(self._server.conditions)

    def open(self) -> None:
        """Serve the page and wait until a browser has opened it. Raises DeviceInUse, DeviceTimeout, DeviceError."""
        if self._open:
            raise DeviceError("the screen's page is served already; close the display first")
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

    def show(self, patch: DisplayPatch) -> None:
        """Show a patch and return once the browser has painted it.

        Raises:
            SettingOutOfRange: If a drive is not between 0 and 1.
            DeviceTimeout: If the page does not answer.
            DeviceLost: If it was closed.
            DeviceError: If it shows another level than asked for.
        """
        wanted = _codes(patch.rgb)
        message = {
            "kind": "show",
            "sequence": next(self._numbers),
            "rgb": wanted,
            "surround": _codes(patch.surround_rgb),
            "width": _fraction("width", patch.width_fraction),
            "height": _fraction("height", patch.height_fraction),
        }
        shown = self._server.ask(message, self._show_timeout_s)
        if shown.get("rgb") != wanted:
            raise DeviceError(
                f"the browser shows {shown.get('rgb')} where {wanted} was asked for; switch off colour filters, "
                "dark-mode extensions and forced colours"
            )

    def warnings(self) -> list[str]:
        """Return what on the page's side may falsify a measurement."""
        return page_warnings(self._server.conditions)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


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


def _codes(rgb: tuple[float, float, float]) -> list[int]:
    for name, drive in zip(("red", "green", "blue"), rgb, strict=True):
        if not 0.0 <= drive <= 1.0:
            raise SettingOutOfRange("screen", f"{name} drive", drive, 0.0, 1.0, "")
    return [round(drive * _LEVELS) for drive in rgb]


def _fraction(name: str, value: float) -> float:
    if not 0.0 < value <= 1.0:
        raise SettingOutOfRange("screen", f"patch {name}", value, 0.0, 1.0, "of the screen")
    return value
