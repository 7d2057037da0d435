"""Interface of every display, real or simulated."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable


@dataclass(frozen=True, slots=True)
class DisplayPatch:
    """A uniform patch on a uniform surround.

    Attributes:
        rgb: Red, green and blue drive, 0 to 1.
        surround_rgb: Drive of the surround.
        width_fraction: Width of the patch as a fraction of the screen's; 1 fills it.
        height_fraction: Height of the patch as a fraction of the screen's.
    """

    rgb: tuple[float, float, float]
    surround_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    width_fraction: float = 1.0
    height_fraction: float = 1.0


@runtime_checkable
class Display(Protocol):
    """A screen that shows a patch and says when it is on."""

    def open(self) -> None:
        """Take the screen. Raises DeviceNotFound."""
        ...

    def close(self) -> None:
        """Release the screen; closing twice does nothing."""
        ...

    def show(self, patch: DisplayPatch) -> None:
        """Show a patch and return once it is on screen. Raises DeviceTimeout, DeviceLost."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
