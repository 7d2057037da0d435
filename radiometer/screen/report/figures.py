"""Figures of a display report: quantities derived from readings, sections, and what every method works with."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol

import numpy as np

from radiometer.analysis.reading.budget import propagated_u
from radiometer.data import Flag, Patch, Quantity, RadianceMap, Reading
from radiometer.devices import DisplayPatch
from radiometer.errors import MeasurementError
from radiometer.numbers import unit_text, upper_limit
from radiometer.screen.calibration_run import Instrumented
from radiometer.screen.report.geometry import CENTRE, field_at
from radiometer.screen.run import Light
from radiometer.typing import Array

WHITE: Final = DisplayPatch((1.0, 1.0, 1.0))
BLACK: Final = DisplayPatch((0.0, 0.0, 0.0))
Bound = Literal["", "above", "below"]


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


def relative(name: str, share: Quantity) -> Figure:
    """Return a figure that is 0 for an ideal display, such as an excess, in %."""
    return Figure(name, share.scaled(100.0, "%"))


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


def contrast_of(bright: Sequence[Reading], dark: Sequence[Reading], name: str, drift_rel: float = 0.0) -> Figure:
    """Return the ratio of two means; a lower bound where the dark one does not rise above its uncertainty."""
    count = len(bright)
    white, black = (derived(one, lambda v: float(v.mean())) for one in (bright, dark))
    if black.value < 3.0 * black.u:  # three standard deviations of the blank: IUPAC's limit of detection
        lowest = max(white.value - 2.0 * white.u, 0.0) / upper_limit(black.value, black.u)
        return Figure(name, Quantity(lowest, float("nan"), "1"), "above")
    ratio = derived([*bright, *dark], lambda v: float(v[:count].mean() / v[count:].mean()))
    # All readings of white are of one moment, all of black of another.
    return Figure(name, Quantity(ratio.value, math.hypot(ratio.u, ratio.value * drift_rel), "1"))
