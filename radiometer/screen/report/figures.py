"""What every method of a display report works with: geometries and places, readings, derived quantities, sections."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol

import numpy as np

from radiometer.analysis.reading.budget import propagated_u
from radiometer.data import Flag, Patch, Quantity, RadianceMap, Reading
from radiometer.devices import DisplayPatch
from radiometer.errors import MeasurementError, UsageError
from radiometer.numbers import unit_text, upper_limit
from radiometer.screen.calibration_run import Instrumented
from radiometer.screen.run import Light
from radiometer.typing import Array

WHITE: Final = DisplayPatch((1.0, 1.0, 1.0))
BLACK: Final = DisplayPatch((0.0, 0.0, 0.0))
Bound = Literal["", "above", "below"]


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


class ReportBench(Instrumented, Protocol):
    """A display with a camera that reads places of it and takes its picture."""

    def readings(self, places: Sequence[Patch]) -> list[Reading]:
        """Return the radiance of places, all from the same frames. Raises DeviceError, MeasurementError."""

    def map_of(self, area: Patch) -> RadianceMap:
        """Return the radiance of every pixel of an area. Raises DeviceError, MeasurementError."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One result of a method; a bound is what the true value is above or below with 95 %."""

    name: str
    quantity: Quantity
    bound: Bound = ""

    @property
    def text(self) -> str:
        """Return it as it is printed, with its expanded uncertainty (k = 2) or as a bound."""
        if not self.bound:
            return self.quantity.text()
        value = f"{self.quantity.value:.3g} {unit_text(self.quantity.unit)}".strip()
        return f"{'>' if self.bound == 'above' else '<'} {value}"


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Results of one method."""

    method: str  # its name in commands and files
    title: str  # its name, with the section of the IDMS where it is one of its methods
    conditions: tuple[str, ...]  # what was shown and how it was measured, a sentence each
    figures: tuple[Figure, ...]  # its results
    columns: tuple[str, ...] = ()  # headings of its table
    rows: tuple[tuple[str | float | Quantity, ...], ...] = ()  # cells of its table
    notes: tuple[str, ...] = ()  # what limits the results, a sentence each
    picture: Array | None = None  # values over the screen, shape (height, width); None for none

    def figure(self, name: str) -> Figure:
        """Return a figure by name. Raises KeyError."""
        return {one.name: one for one in self.figures}[name]


@dataclass(frozen=True, slots=True)
class Examined:
    """A display before its camera, and how it is to be measured."""

    bench: ReportBench
    area: Patch  # where the camera sees the whole screen
    lights: Mapping[str, Light]  # light of every channel whose spectrum is known
    turn: Callable[[float], None]  # turns the screen to an angle in degrees from its normal
    points: int
    checkers: tuple[int, int]
    levels: tuple[int, ...]
    angles_deg: tuple[float, ...]
    unsettled_rel: float = 0.0  # standard uncertainty of the display's output between two readings

    def shown(self, patch: DisplayPatch, places: Sequence[tuple[float, float]] = (CENTRE,)) -> list[Reading]:
        """Show a patch and return the readings of places. Raises DeviceError, and MeasurementError if one clips."""
        self.bench.display.show(patch)
        found = self.bench.readings([field_at(self.area, place) for place in places])
        if any(Flag.SATURATED in one.flags for one in found):
            raise MeasurementError(
                "the screen clips even at the shortest exposure; close the aperture or use a grey filter"
            )
        return found

    def luminance(self, radiance: Quantity, channel: str = "grey") -> Quantity:
        """Return the luminance in cd·m⁻² of a radiance in a channel's light."""
        light = self.lights[channel]
        u = math.hypot(radiance.u, radiance.value * light.u_photopic_rel)
        return Quantity(radiance.value, u, radiance.unit).scaled(light.photopic_lm_per_w, "cd m-2")


def derived(
    readings: Sequence[Reading], of: Callable[[Array], float], unit: str = "1", drift_rel: float = 0.0
) -> Quantity:
    """Return a function of the radiances of readings of one calibration, with its standard uncertainty.

    The display's output has the relative standard uncertainty `drift_rel` from one reading to the next.
    """
    values, own_u = np.array([(one.radiance.value, one.radiance.u) for one in readings]).T
    # A thousandth of u: small against any bend within u, large against rounding.
    steps = np.maximum(1e-3 * own_u, 1e-9 * np.abs(values).max())
    gradient = np.array([of(values + moved) - of(values - moved) for moved in np.diag(steps)]) / (2 * steps)
    u = np.hypot(propagated_u(readings, gradient), float(np.linalg.norm(gradient * values)) * drift_rel)
    return Quantity(float(of(values)), float(u), unit)


def ratio_of(bright: Sequence[Reading], dark: Sequence[Reading], name: str, drift_rel: float = 0.0) -> Figure:
    """Return the ratio of two means; a lower bound where the dark one does not rise above its uncertainty."""
    count = len(bright)
    white, black = (derived(one, lambda v: float(v.mean())) for one in (bright, dark))
    if black.value < 3.0 * black.u:  # three standard deviations of the blank: IUPAC's limit of detection
        lowest = max(white.value - 2.0 * white.u, 0.0) / upper_limit(black.value, black.u)
        return Figure(name, Quantity(lowest, float("nan"), "1"), "above")
    ratio = derived([*bright, *dark], lambda v: float(v[:count].mean() / v[count:].mean()))
    # All readings of white are of one moment, all of black of another.
    return Figure(name, Quantity(ratio.value, math.hypot(ratio.u, ratio.value * drift_rel), "1"))
