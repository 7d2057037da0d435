"""A Display that is a page in a browser: any screen that can open an address."""

from __future__ import annotations

from typing import Final

from radiometer.devices import DisplayPatch
from radiometer.errors import SettingOutOfRange
from radiometer.screen.browser_page import BrowserPage, require_shown

_LEVELS: Final = 255  # a canvas holds 8 bits per channel


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
