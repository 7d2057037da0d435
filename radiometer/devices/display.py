"""Interface of every display, real or simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable


@dataclass(frozen=True, slots=True)
class DisplayPatch:
    """A uniform patch on a uniform surround, or a checkerboard of both."""

    rgb: tuple[float, float, float]  # red, green and blue drive, 0 to 1
    surround_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)  # drive of the surround
    width_fraction: float = 1.0  # width of the patch as a fraction of the screen's; 1 fills it
    height_fraction: float = 1.0  # height of the patch as a fraction of the screen's
    # Columns and rows of a checkerboard over the whole screen, its top left field as `rgb`; None for a patch
    checkers: tuple[int, int] | None = None


@runtime_checkable
class Display(Protocol):
    """A screen that shows a patch and says when it is on."""

    def open(self) -> None:
        """Take the screen. Raises DeviceNotFound."""

    def close(self) -> None:
        """Release the screen; closing twice does nothing."""

    def show(self, patch: DisplayPatch) -> None:
        """Show a patch and return once it is on screen. Raises DeviceTimeout, DeviceLost."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...
