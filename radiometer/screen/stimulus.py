"""Stimulus on a screen for a subject: a field, a mark, a spot; and their places for an eye at a distance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from radiometer.errors import ConfigurationError

Code = tuple[int, int, int]
BLACK: Code = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class Shape:
    """A uniform ellipse."""

    x: float  # its middle right of the screen's middle in pixels
    y: float  # its middle below the screen's middle in pixels
    width: float  # its width in pixels
    height: float  # its height in pixels
    rgb: Code  # codes 0 to 255 of red, green and blue


@dataclass(frozen=True, slots=True)
class ScreenPicture:
    """A uniform field with shapes on it, the last in front."""

    field: Code = BLACK
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True, slots=True)
class Hold:
    """The longest press since last asked: how long it lasted, or has lasted so far, and how long ago it began, in s."""

    lasted_s: float = 0.0
    began_ago_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Blink:
    """How a blink went, on the screen's own clock."""

    presses_s: tuple[float, ...]  # presses in s from the onset of the light
    hold: Hold  # the longest press, begun before or during it
    on_s: float  # how long the light was on
    frame_s: float  # time between two frames


@dataclass(frozen=True, slots=True)
class Rest:
    """What was pressed while nothing was shown: how often, and the longest press."""

    presses: int
    hold: Hold


class StimulusScreen(Protocol):
    """A screen before a subject, with a button."""

    def show(self, picture: ScreenPicture) -> None:
        """Show a picture and return once it is on screen. Raises DeviceError."""

    def blink(self, lit: ScreenPicture, rest: ScreenPicture, on_s: float, cycle_s: float) -> Blink:
        """Show `lit` for a time, then `rest` until the cycle is over; return what was pressed. Raises DeviceError."""

    def rest(self, seconds: float) -> Rest:
        """Let time pass and return what was pressed. Raises DeviceError."""

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height of the screen in pixels."""

    def warnings(self) -> list[str]:
        """Return what on the screen's side may falsify a test."""


@dataclass(frozen=True, slots=True)
class Viewing:
    """An eye before the middle of a flat screen, the mark and the spot on either side of it."""

    distance_mm: float  # distance of the eye from the screen in mm
    pixel_mm: float  # distance of two pixels in mm

    def ellipse(self, at_deg: float, size_deg: float, rgb: Code, below_deg: float = 0.0) -> Shape:
        """Return what covers a circle of visual angle around a direction in, or not far from, the horizontal.

        Args:
            at_deg: Direction from the screen's middle, right of it positive.
            size_deg: Diameter in degrees.
            below_deg: How far below the horizontal; a few degrees, for the shape is that in the horizontal.
        """
        scale = self.distance_mm / self.pixel_mm
        left, right = (math.tan(math.radians(at_deg + side * size_deg / 2)) for side in (-1, 1))
        height = 2.0 * math.tan(math.radians(size_deg / 2)) / math.cos(math.radians(at_deg))
        y = math.tan(math.radians(below_deg)) / math.cos(math.radians(at_deg))
        return Shape(scale * (left + right) / 2, scale * y, scale * (right - left), scale * height, rgb)

    def direction_deg(self, shape: Shape) -> tuple[float, float]:
        """Return where the middle of a shape stands, in degrees right of and above the screen's middle."""
        x_mm, y_mm = shape.x * self.pixel_mm, shape.y * self.pixel_mm
        right = math.atan2(x_mm, self.distance_mm)
        return math.degrees(right), -math.degrees(math.atan2(y_mm, math.hypot(x_mm, self.distance_mm)))

    def require_room(self, shapes: tuple[Shape, ...], size: tuple[int, int]) -> None:
        """Refuse shapes that a screen of a width and height in pixels does not hold. Raises ConfigurationError."""
        for shape in shapes:
            reach = 2 * (abs(shape.x) + shape.width / 2)
            if reach > size[0] or 2 * abs(shape.y) + shape.height > size[1]:
                raise ConfigurationError(
                    f"mark and spot need a page {reach:.0f} pixels wide at {self.distance_mm:g} mm; it has {size[0]}: "
                    "go to full screen, sit closer (viewing.distance_mm) or lower spot.eccentricity_deg"
                )
