"""A Display that is a page in a browser: any screen that can open an address."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from radiometer.devices import DisplayPatch
from radiometer.errors import SettingOutOfRange
from radiometer.screen.browser_page import BrowserPage, require_shown
from radiometer.screen.loopback import Darken, nothing_to_darken
from radiometer.screen.page_server import PageServer

_LEVELS: Final = 255  # a canvas holds 8 bits per channel


class BrowserDisplay(BrowserPage):
    """Shows patches through the page; every patch is acknowledged after it was painted, and read back.

    Args:
        port: Port on 127.0.0.1; 0 for any free one.
        announce: Called with the address once it is served; opens a browser or prints it.
        page_timeout_s: How long to wait for a browser to open it.
        start_timeout_s: How long to wait for somebody to press Start; None where nothing is to be waited for.
        darken: Darkens the light box, whoever holds it, for the page's key O; returns what it did in words.
        show_timeout_s: How long a patch may take to appear.
    """

    def __init__(
        self,
        port: int = 0,
        *,
        announce: Callable[[str], None] = lambda url: None,
        page_timeout_s: float = 120.0,
        start_timeout_s: float | None = None,
        darken: Darken = nothing_to_darken,
        show_timeout_s: float = 5.0,
    ) -> None:
        super().__init__(
            PageServer(port, darken=darken), "the screen's page", announce, page_timeout_s, start_timeout_s
        )
        self._show_timeout_s = show_timeout_s

    def show(self, patch: DisplayPatch) -> None:
        """Show a patch and return once the browser has painted it.

        Raises:
            SettingOutOfRange: If a drive is not between 0 and 1.
            DeviceTimeout: If the page does not answer.
            DeviceLost: If it was closed.
            DeviceError: If it shows another level than asked for.
        """
        wanted = _codes(patch.rgb)
        order = {
            "kind": "show",
            "rgb": wanted,
            "surround": _codes(patch.surround_rgb),
            "width": _fraction("width", patch.width_fraction),
            "height": _fraction("height", patch.height_fraction),
        }
        require_shown(self._ask(order, self._show_timeout_s).get("rgb"), wanted)


def _codes(rgb: tuple[float, float, float]) -> list[int]:
    for name, drive in zip(("red", "green", "blue"), rgb, strict=True):
        if not 0.0 <= drive <= 1.0:
            raise SettingOutOfRange("screen", f"{name} drive", drive, 0.0, 1.0, "")
    return [round(drive * _LEVELS) for drive in rgb]


def _fraction(name: str, value: float) -> float:
    if not 0.0 < value <= 1.0:
        raise SettingOutOfRange("screen", f"patch {name}", value, 0.0, 1.0, "of the screen")
    return value
