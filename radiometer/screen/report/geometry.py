"""Presets of the geometry that a display is measured in, and the places on it where it is sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from radiometer.data import Patch
from radiometer.errors import UsageError

# Places as shares of width and height. Nine: the outer ones 10 % from the edges (IDMS 8.1). Thirteen: the middles of
# 3 × 3 equal fields, and four places at 10 % of the way from the corners to the centre (IEC 61947-1, ANSI IT7.228).
# Twenty-five: 5 × 5 places with the nine among them.
_TENTHS: Final = (0.1, 0.5, 0.9)
_THIRDS: Final = (1 / 6, 1 / 2, 5 / 6)
_CORNERS: Final = tuple((x, y) for y in (0.05, 0.95) for x in (0.05, 0.95))
_FIFTHS: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
POINTS: Final = {
    9: tuple((x, y) for y in _TENTHS for x in _TENTHS),
    13: (*((x, y) for y in _THIRDS for x in _THIRDS), *_CORNERS),
    25: tuple((x, y) for y in _FIFTHS for x in _FIFTHS),
}
TITLES: Final = {
    9: "Sampled vantage-point uniformity (9 points, IDMS 8.1.2)",
    13: "Sampled uniformity (13 points, IEC 61947-1)",
    25: "Sampled uniformity (25 points)",
}
CENTRE: Final = (0.5, 0.5)
FIELD_SHARE: Final = 0.08  # side of a measuring field over the height: it fits at the corner places, 5 % from the edge
_FEWEST_PX: Final = 3  # a field of fewer pixels on a side says nothing of its scatter


@dataclass(frozen=True, slots=True)
class Geometry:
    """How display and camera stand to each other."""

    name: str
    conditions: tuple[str, ...]  # sentences for the report
    angles_deg: tuple[float, ...] = ()  # angles from the normal to measure at, besides 0
    pupil_mm: tuple[float, float] | None = None  # least and largest entrance pupil of the lens; None for any


GEOMETRIES: Final = {
    one.name: one
    for one in (
        Geometry("direct", ("the camera looks along the normal at the centre of the screen",)),
        Geometry(
            "viewing_angle",
            (
                "the camera looks at the centre of the screen",
                "the screen is turned about its vertical axis through the centre; angles count from the normal",
            ),
            (-60.0, -45.0, -30.0, -15.0, 15.0, 30.0, 45.0, 60.0),
        ),
        Geometry(
            "near_eye",
            (
                "the entrance pupil of the lens is in the eye point of the display, and its axis along the eye's",
                "the camera is focused at the virtual image; places are shares of its width and height",
            ),
            pupil_mm=(2.0, 5.0),  # IEC 63145-20-10: as of an eye
        ),
    )
}


def geometry_of(name: str) -> Geometry:
    """Return a preset by name. Raises UsageError for another name."""
    if name not in GEOMETRIES:
        raise UsageError(f"geometry {name!r} is unknown; choose {', '.join(GEOMETRIES)}")
    return GEOMETRIES[name]


def field_at(area: Patch, place: tuple[float, float]) -> Patch:
    """Return the measuring field at a place of the screen.

    Raises:
        UsageError: If it would have less than 3 pixels on a side.
    """
    side = round(FIELD_SHARE * area.height)
    if side < _FEWEST_PX:
        raise UsageError(
            f"the screen is {area.width} × {area.height} pixels in the camera's picture: too small for a measuring "
            f"field of {100 * FIELD_SHARE:g} % of its height; move the camera closer"
        )
    x = area.x + place[0] * area.width - side / 2
    y = area.y + place[1] * area.height - side / 2
    return Patch(max(area.x, round(x)), max(area.y, round(y)), side, side)
