"""Presets of the geometry that a display is measured in, and the places on it where it is sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from radiometer.data import Patch
from radiometer.errors import UsageError


def _grid(*shares: float) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for y in shares for x in shares)


# Titles, and places as shares of width and height. Nine: the outer ones 10 % from the edges. Thirteen: the middles of
# 3 × 3 equal fields, and four places at 10 % of the way from the corners to the centre (also ANSI IT7.228).
# Twenty-five: 5 × 5 places with the nine among them.
POINTS: Final = {
    9: ("Sampled vantage-point uniformity (9 points, IDMS 8.1.2)", _grid(0.1, 0.5, 0.9)),
    13: ("Sampled uniformity (13 points, IEC 61947-1)", (*_grid(1 / 6, 1 / 2, 5 / 6), *_grid(0.05, 0.95))),
    25: ("Sampled uniformity (25 points)", _grid(0.1, 0.3, 0.5, 0.7, 0.9)),
}
CENTRE: Final = (0.5, 0.5)
FIELD_SHARE: Final = 0.08  # side of a measuring field over the height: it fits at the corner places, 5 % from the edge
_FEWEST_PX: Final = 3  # a field of fewer pixels on a side says nothing of its scatter


@dataclass(frozen=True, slots=True)
class Geometry:
    """How display and camera stand to each other."""

    conditions: tuple[str, ...]  # sentences for the report
    angles_deg: tuple[float, ...] = ()  # angles from the normal to measure at, besides 0
    pupil_mm: tuple[float, float] | None = None  # least and largest entrance pupil of the lens; None for any


GEOMETRIES: Final = {
    "direct": Geometry(("the camera looks along the normal at the centre of the screen",)),
    "viewing_angle": Geometry(
        (
            "the camera looks at the centre of the screen",
            "the screen is turned about its vertical axis through the centre; angles count from the normal",
        ),
        (-60.0, -45.0, -30.0, -15.0, 15.0, 30.0, 45.0, 60.0),
    ),
    "near_eye": Geometry(
        (
            "the entrance pupil of the lens is in the eye point of the display, and its axis along the eye's",
            "the camera is focused at the virtual image; places are shares of its width and height",
        ),
        pupil_mm=(2.0, 5.0),  # IEC 63145-20-10: as of an eye
    ),
}


def field_at(area: Patch, place: tuple[float, float]) -> Patch:
    """Return the measuring field at a place of the screen. Raises UsageError where it has less than 3 pixels a side."""
    side = round(FIELD_SHARE * area.height)
    if side < _FEWEST_PX:
        raise UsageError(
            f"the screen is {area.width} × {area.height} pixels in the camera's picture: too small for a measuring "
            f"field of {100 * FIELD_SHARE:g} % of its height; move the camera closer"
        )
    x = area.x + place[0] * area.width - side / 2
    y = area.y + place[1] * area.height - side / 2
    return Patch(max(area.x, round(x)), max(area.y, round(y)), side, side)
