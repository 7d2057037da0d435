"""Report of a display: methods of the Information Display Measurements Standard (IDMS), each with conditions and u.

Source: IDMS 1.1 and later (Society for Information Display), sections 5.3, 5.6, 5.14, 5.26, 8.1.2 and 9.4, as the
Digital Cinema Compliance Test Plan 1.4.3 applies them; 8.2.3 by its title in IDMS 1.03.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal, Protocol

import numpy as np
from scipy.ndimage import gaussian_filter, label
from scipy.optimize import curve_fit
from scipy.special import ndtri

from radiometer.analysis.reading.budget import propagated_u
from radiometer.analysis.regions import LOST
from radiometer.data import Flag, Patch, Quantity, RadianceMap, Reading
from radiometer.devices import DisplayPatch
from radiometer.errors import MeasurementError, UsageError
from radiometer.numbers import unit_text, upper_limit
from radiometer.screen.calibration_run import Instrumented
from radiometer.screen.run import (
    CHANNELS,
    REFERENCES,
    TOP,
    Light,
    ScreenReading,
    ScreenStep,
    WarmUp,
    measure_steps,
    wait_until_steady,
)
from radiometer.statistics.scale import spread_beyond_noise
from radiometer.typing import Array

WHITE: Final = DisplayPatch((1.0, 1.0, 1.0))
BLACK: Final = DisplayPatch((0.0, 0.0, 0.0))
_STEEP: Final = 0.9  # of the drive: above it the logarithm that a local gamma is divided by is nearly 0
_CONTRADICTION_REL: Final = 0.01  # of white: below it, assumed spectra agree as well as cameras measure
_LIMITS: Final = (0.05, 0.01)  # warm-up is over within 5 %, or within 1 %, of the final luminance
# Standard deviations of the two Gaussians over the height: finer structure is noise and pixels, coarser one shading.
_FINE_SHARE: Final = 0.02
_COARSE_SHARE: Final = 0.15
_DEGREE: Final = 4  # of the polynomial of x and y that takes off the shading, which a border would show as a spot
_FEWEST_GOOD: Final = 0.9  # share of pixels with a value
_PRIMARIES: Final = {name: ScreenStep(name, TOP).patch() for name in CHANNELS if name != "grey"}


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
    bound: Literal["", "above", "below"] = ""

    @property
    def text(self) -> str:
        """Return it as it is printed, with its expanded uncertainty (k = 2) or as a bound."""
        if not self.bound:
            return self.quantity.text()
        value = f"{self.quantity.value:.3g} {unit_text(self.quantity.unit)}".strip()
        return f"{'>' if self.bound == 'above' else '<'} {value}"


def relative(name: str, share: Quantity) -> Figure:
    """Return a figure in %: one that is 0 for an ideal display, or a place."""
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


def warm_up_section(outcome: WarmUp, examined: Examined) -> Section:
    """Return the warm-up that was watched before all other methods.

    L(t) = L_end·(1 + a·e^(−t/τ)) is fitted where readings and their scatter allow it.
    """
    times, values, own_u = np.array([(one.time_s, one.radiance, one.u_independent) for one in outcome.readings]).T
    times = times - times[0]
    u_excess = math.hypot(own_u[0] / values[0], own_u[-1] / values[-1])
    excess, notes = Quantity(float(values[0] / values[-1] - 1.0), u_excess, "1"), list[str]()
    figures = _relaxation(times, values, own_u) if abs(excess.value) > 3.0 * u_excess else []
    if not figures:
        figures = [relative("excess_at_start", excess)]
        notes.append("the change is too small, or was watched for too short, for the time constant")
    drift = Quantity(outcome.drift_rel, u_excess, "1").scaled(100.0, f"% in {outcome.drift_s:.0f} s")
    figures.append(Figure("drift_at_end", drift))
    if not outcome.steady:
        notes.append("not steady when the time was up: later figures hold the change of white in their uncertainty")
    rows = tuple(
        (f"{t:.0f} s", examined.luminance(Quantity(v, u, "")))
        for t, v, u in zip(times.tolist(), values.tolist(), own_u.tolist(), strict=True)
    )
    return Section(
        "warm_up", "Warm-up", ("full-screen white from the moment the display was taken",), tuple(figures),
        ("time", "luminance (cd·m⁻²)"), rows, tuple(notes),
    )  # fmt: skip


def _relaxation(times: Array, values: Array, own_u: Array) -> list[Figure]:
    """Return amplitude, time constant, and when luminance is within each limit of the final one: τ·ln(|a|/limit).

    None are returned where the data do not hold them.
    """
    if times.size < 4:
        return []
    start = (float(values[-1]), float(values[0] / values[-1] - 1.0), float(times[-1]) / 2.0)

    def law(t: Array, end: float, size: float, tau: float) -> Array:
        return np.asarray(end * (1.0 + size * np.exp(-t / tau)))

    try:
        found, spread = curve_fit(law, times, values, start, np.maximum(own_u, 1e-9 * values), absolute_sigma=True)
    except RuntimeError:  # no convergence: the change is no single exponential
        return []
    gap = (values - law(times, *found)) / np.maximum(own_u, 1e-9 * values)
    spread = spread * max(1.0, float(np.sum(gap**2)) / (times.size - 3))
    (_, size, tau), (_, u_size, u_tau) = found.tolist(), np.sqrt(np.diag(spread)).tolist()
    if not (tau > 0.0 and u_tau <= 0.5 * tau):
        return []
    figures = [
        relative("excess_at_start", Quantity(size, u_size, "1")),
        Figure("time_constant", Quantity(tau, u_tau, "s")),
    ]
    for limit in _LIMITS:
        ratio = max(abs(size) / limit, 1.0)
        slope = np.array([0.0, tau / size, math.log(ratio)]) if ratio > 1.0 else np.zeros(3)
        u = math.sqrt(max(float(slope @ spread @ slope), 0.0))
        figures.append(Figure(f"warm_up_time_{100 * limit:g}_percent", Quantity(tau * math.log(ratio), u, "s")))
    return figures


def _white(examined: Examined) -> Section:
    (reading,) = examined.shown(WHITE)
    figures = (Figure("luminance", examined.luminance(reading.radiance)), Figure("radiance", reading.radiance))
    return Section("white", "Full-screen white (IDMS 5.3)", ("full-screen white, centre",), figures)


def _black_figure(examined: Examined, reading: Reading) -> Figure:
    black = examined.luminance(reading.radiance)
    if black.value < 3.0 * black.u:
        limit = upper_limit(black.value, black.u)
        return Figure("luminance", Quantity(limit, float("nan"), black.unit), "below")
    return Figure("luminance", black)


def _black(examined: Examined) -> Section:
    figure = _black_figure(examined, *examined.shown(BLACK))
    return Section("black", "Full-screen black (IDMS 5.6)", ("full-screen black, centre",), (figure,))


def _sequential(examined: Examined) -> Section:
    figure = ratio_of(examined.shown(WHITE), examined.shown(BLACK), "contrast", examined.unsettled_rel)
    conditions = ("full-screen white, then full-screen black, centre",)
    return Section("sequential_contrast", "Sequential contrast", conditions, (figure,))


def _checkerboard(examined: Examined) -> Section:
    columns, rows = examined.checkers
    fields = [(i, j) for j in range(rows) for i in range(columns)]
    board = DisplayPatch((1.0, 1.0, 1.0), checkers=examined.checkers)
    read, cells = [], []
    for odd, kind in enumerate(("white", "black")):
        own = [one for one in fields if sum(one) % 2 == odd]
        read.append(examined.shown(board, [((i + 0.5) / columns, (j + 0.5) / rows) for i, j in own]))
        for (i, j), reading in zip(own, read[-1], strict=True):
            cells.append((f"column {i + 1}, row {j + 1}", kind, examined.luminance(reading.radiance)))
    return Section(
        "checkerboard_contrast",
        f"Checkerboard luminance and contrast ({columns} × {rows}, IDMS 5.26; ANSI contrast for 4 × 4)",
        (f"checkerboard of {columns} × {rows} fields; mean of white over mean of black fields' middles (C_Cave)",),
        (ratio_of(read[0], read[1], "contrast", examined.unsettled_rel),),
        ("field", "shown", "luminance (cd·m⁻²)"), tuple(cells),
        ("light that the lens scatters from white into black fields counts as far as the calibration states it",),
    )  # fmt: skip


def _gamma(examined: Examined) -> Section:
    (black,), (white,) = examined.shown(BLACK), examined.shown(WHITE)
    drives = np.array([level / TOP for level in examined.levels if 0 < level < TOP])
    greys = [examined.shown(DisplayPatch((drive, drive, drive)))[0] for drive in drives.tolist()]
    dark, drift = black.radiance, examined.unsettled_rel
    clear = [one.radiance.value - dark.value > 3.0 * math.hypot(one.radiance.u, dark.u) for one in greys]
    readings = [black, *(one for one, kept in zip(greys, clear, strict=True) if kept), white]
    logs = np.log(np.append(drives[clear], 1.0))

    def line(values: Array) -> tuple[float, float]:
        """Return slope and misfit of the line through ln of the light above black."""
        light = np.log(np.maximum(values[1:] - values[0], 1e-300))
        found = np.polyfit(logs, light, 1)
        return float(found[0]), float(np.sqrt(np.mean((light - np.polyval(found, logs)) ** 2)))

    rows = []
    for drive, one, kept in zip(drives.tolist(), greys, clear, strict=True):
        local: str | Quantity = "–"
        if kept and drive <= _STEEP:
            local = derived([black, one, white], partial(_local, drive=drive), drift_rel=drift)
        rows.append((f"{round(drive * TOP)}", examined.luminance(one.radiance), local))
    notes = () if all(clear) else ("levels that do not rise above black by three standard uncertainties are left out",)
    slope = derived(readings, lambda values: line(values)[0], drift_rel=drift)
    misfit = derived(readings, lambda values: line(values)[1], drift_rel=drift)
    # Where the greys follow no power, the slope depends on which levels were read.
    of_line = misfit.value / max(float(np.std(logs)) * math.sqrt(max(logs.size - 2, 1)), 1e-300)
    return Section(
        "gamma", "Gamma of the greys",
        (f"{len(drives)} greys, full screen, centre; slope of ln(L − L_black) over ln(level)",),
        (Figure("gamma", replace(slope, u=math.hypot(slope.u, of_line))), relative("misfit_rms", misfit)),
        ("level", "luminance (cd·m⁻²)", "local gamma"), tuple(rows), notes,
    )  # fmt: skip


def _local(values: Array, drive: float) -> float:
    """Return the exponent between a level and white: ln((L − L_black)/(L_white − L_black))/ln(drive)."""
    share = max((values[1] - values[0]) / (values[2] - values[0]), 1e-300)
    return float(math.log(share) / math.log(drive))


def _primaries(examined: Examined) -> Section:
    rows, figures, notes = [], [], []
    read = {name: examined.shown(patch)[0].radiance for name, patch in (*_PRIMARIES.items(), ("white", WHITE))}
    doubt = _doubt_of_spectra(examined, read)
    for name, radiance in read.items():
        channel = "grey" if name == "white" else name
        if channel not in examined.lights:
            figures.append(Figure(f"{name}_radiance", radiance))
            continue
        light = examined.luminance(radiance, channel)
        light = replace(light, u=math.hypot(light.u, light.value * doubt))
        figures.append(Figure(f"{name}_luminance", light))
        rows.append((name, radiance, light, examined.lights[channel].spectrum))
    if doubt > _CONTRADICTION_REL:
        notes.append(
            f"the assumed spectra contradict each other: the luminances of the primaries and of white differ by "
            f"{100 * doubt:.2g} % more than their radiances, which u holds; state --white and --primaries"
        )
    if len(rows) == 1:
        notes.append("luminances of the primaries need their spectra: --primaries")
    notes.append("a grey camera does not see chromaticity: measure it with radiometer colour")
    return Section(
        "primaries", "Full-screen primary colors (IDMS 5.14) and white",
        ("full-screen red, green, blue and white, centre",), tuple(figures),
        ("shown", "radiance (W·sr⁻¹·m⁻²)", "luminance (cd·m⁻²)", "spectrum assumed"), tuple(rows), tuple(notes),
    )  # fmt: skip


def _doubt_of_spectra(examined: Examined, read: Mapping[str, Quantity]) -> float:
    """Return by which share of white the luminances of the primaries miss it, where their radiances do not."""
    if any(name not in examined.lights for name in (*_PRIMARIES, "grey")):
        return 0.0
    lit = {name: examined.luminance(one, "grey" if name == "white" else name).value for name, one in read.items()}
    of_light = sum(lit[name] for name in _PRIMARIES) / lit["white"]
    return abs(of_light - sum(read[name].value for name in _PRIMARIES) / read["white"].value)


def _additivity(examined: Examined) -> Section:
    readings = [examined.shown(one)[0] for one in (*_PRIMARIES.values(), WHITE, BLACK)]
    # The black counts once in each of the three and once in white.
    error = derived(
        readings, lambda v: float((v[:3].sum() - 3.0 * v[4]) / (v[3] - v[4]) - 1.0), drift_rel=examined.unsettled_rel
    )
    return Section(
        "additivity", "Additivity of the primaries",
        ("full-screen red, green, blue, white and black, centre; radiance of the sum over white, less 1",),
        (relative("additivity_error", error),),
        notes=("colours are compared in radiance, so no spectrum is assumed beyond the calibration's",),
    )  # fmt: skip


def _uniformity(examined: Examined) -> Section:
    title, places = POINTS[examined.points]
    readings = examined.shown(WHITE, places)
    values = np.array([one.radiance.value for one in readings])
    own = np.array([math.sqrt(sum(c.u_rel**2 for c in one.budget if not c.correlated)) for one in readings]) * values
    low, high = int(values.argmin()), int(values.argmax())
    ratio = derived([readings[low], readings[high]], lambda v: float(v[0] / v[1]))
    # Of n places that noise cannot part, the extreme is off by nothing where they differ, by the extreme of n draws of
    # noise where they are equal. The middle of both is taken, as of a rectangle.
    off = 0.0
    for i in (low, high):
        ties = int(np.sum(np.abs(values - values[i]) < 2.0 * np.hypot(own, own[i])))
        expected = max(0.0, float(ndtri((ties - 0.375) / (ties + 0.25))))  # largest of n draws over σ: Blom 1958
        off += own[i] / values[i] * expected / 2.0
    value = min(ratio.value * (1.0 + off), 1.0)
    u = math.hypot(ratio.u, value * off / math.sqrt(3.0))
    centre = places.index(CENTRE)
    rows = tuple(
        (
            f"{100 * x:.1f} %, {100 * y:.1f} %",
            examined.luminance(one.radiance),
            derived([one, readings[centre]], lambda v: float(v[0] / v[1])) if i != centre else "centre",
        )
        for i, ((x, y), one) in enumerate(zip(places, readings, strict=True))
    )
    figures = (
        Figure("uniformity", Quantity(value, u, "1")),
        relative("nonuniformity", Quantity(1.0 - value, u, "1")),
        Figure("mean_luminance", examined.luminance(derived(readings, lambda v: float(v.mean()), "W sr-1 m-2"))),
    )
    return Section(
        "uniformity", title,
        (f"full-screen white at {examined.points} points, all from the same frames; lowest over highest",),
        figures, ("place (from left, from top)", "luminance (cd·m⁻²)", "over the centre"), rows,
    )  # fmt: skip


def _mura(examined: Examined) -> Section:
    examined.bench.display.show(WHITE)
    found = mura_of(examined.bench.map_of(examined.area))
    figures = (
        relative("largest_spot", found.spot), relative("largest_spot_x", found.x),
        relative("largest_spot_y", found.y), relative("rms", found.rms),
    )  # fmt: skip
    notes = ["the pattern of the camera's own pixels is in the map unless its calibration holds a flat field"]
    if abs(found.spot.value) < found.detection_limit:
        notes.insert(0, f"the largest spot is no larger than noise can be ({100 * found.detection_limit:.2g} %)")
    return Section(
        "mura", "Mura analysis (IDMS 8.2.3; band-pass filter as below)",
        (
            "full-screen white, every pixel of the camera's picture",
            f"band-pass: Gaussians of {100 * _FINE_SHARE:g} % and {100 * _COARSE_SHARE:g} % of the height, no shading",
            "x and y count from the top left corner, in % of width and height",
        ),
        figures, notes=tuple(notes), picture=100.0 * found.relative,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Mura:
    """Band-passed relative non-uniformity and its largest spot."""

    relative: Array  # band-passed radiance over the shading, shape (height, width)
    spot: Quantity  # contrast of the largest spot after the filter; below 0 where it is dark
    x: Quantity  # its place from the left edge over the width
    y: Quantity  # its place from the upper edge over the height
    rms: Quantity  # standard deviation over the screen, noise taken off
    detection_limit: float  # what noise alone hardly reaches anywhere: 5 % of flat screens exceed it


def mura_of(found: RadianceMap) -> Mura:
    """Return the mura of a white screen that fills a map.

    B = (G_fine ∗ L − G_coarse ∗ L)/S with normalised Gaussians G and the shading S, a polynomial of degree four. The
    polynomial is divided out first. The filters weigh by the pixels that have a value, so they reach the edges. Raises
    MeasurementError if more than a tenth of its pixels have no value.
    """
    good = (found.mask & LOST) == 0
    if float(good.mean()) < _FEWEST_GOOD:
        raise MeasurementError("more than a tenth of the screen has no value: check its area and the exposures")
    light = np.where(good, found.radiance, 0.0).astype(np.float64)
    shading = _shading(light, good)
    flat = np.where(good, light / shading, 0.0)
    own = np.where(good, found.parts_of_u(np.s_[:, :])[0] / shading, 0.0)
    height, width = flat.shape
    fine, coarse = _FINE_SHARE * height, _COARSE_SHARE * height
    weight = _blurred(good.astype(np.float64), fine)
    band = _blurred(flat, fine) / weight - _blurred(flat, coarse) / _blurred(good.astype(np.float64), coarse)
    # The square of a Gaussian is a Gaussian of σ/√2 over 4πσ²; the coarse one adds below a fiftieth of the variance.
    noise = np.sqrt(_blurred(own**2, fine / math.sqrt(2.0)) / (4.0 * math.pi * fine**2)) / weight
    cells = max(2.0, flat.size / (4.0 * math.pi * fine**2))
    # The largest contrast that noise cannot have made: at edges and corners the filter holds fewer pixels.
    sure = np.abs(band) - math.sqrt(2.0 * math.log(cells)) * noise
    y, x = (int(i) for i in np.unravel_index(int(np.argmax(sure)), band.shape))
    spot, u = float(band[y, x]), float(noise[y, x])
    # The largest of many spots of nearly one size is large by chance as well.
    tied = max(1.0, cells * float(np.mean(np.abs(band) > abs(spot) - 2.0 * math.sqrt(2.0) * u)))
    u_spot = u * math.hypot(1.0, math.sqrt(2.0 * math.log(tied)) / math.sqrt(3.0))
    # A maximum of curvature c is found to the noise's slope over c: a blurred spot s²·2π·ln 2 large has c = value/s².
    parts, _ = label(np.sign(spot) * band > abs(spot) / 2.0)
    s_2 = float(np.sum(parts == parts[y, x])) / (2.0 * math.pi * math.log(2.0))
    u_place = math.hypot(s_2 * u / (math.sqrt(2.0) * fine * max(abs(spot), u)), 1.0 / math.sqrt(12.0))
    known = float(np.mean(noise**2))
    pattern = known * float(np.mean((found.u_rel_pattern * flat) ** 2)) / max(float(np.mean(own**2)), 1e-300)
    return Mura(
        band,
        Quantity(spot, u_spot, "1"),
        Quantity((x + 0.5) / width, u_place / width, "1"),
        Quantity((y + 0.5) / height, u_place / height, "1"),
        Quantity(*spread_beyond_noise(float(band.var()), known - pattern, cells, pattern), "1"),
        u * math.sqrt(2.0 * math.log(20.0 * cells)),
    )


def _blurred(values: Array, sigma: float) -> Array:
    return np.asarray(gaussian_filter(values, sigma, mode="constant"), dtype=np.float64)


def _shading(light: Array, good: Array) -> Array:
    """Return the polynomial of x and y that is nearest to the light, shape (height, width)."""
    height, width = light.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    basis = np.stack([x**i * y**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=-1)
    found = np.linalg.lstsq(basis[good], light[good], rcond=None)[0]
    return np.asarray(basis @ found, dtype=np.float64)


def _viewing_angle(examined: Examined) -> Section:
    at: dict[float, tuple[list[Reading], list[Reading]]] = {}
    try:
        for angle in (0.0, *(one for one in examined.angles_deg if one != 0.0)):
            examined.turn(angle)
            at[angle] = examined.shown(WHITE), examined.shown(BLACK)
    finally:
        examined.turn(0.0)
    rows, figures, drift = [], [], examined.unsettled_rel
    for angle, (white, black) in sorted(at.items()):
        share = derived([white[0], at[0.0][0][0]], lambda v: float(v[0] / v[1]), drift_rel=drift)
        contrast = ratio_of(white, black, f"contrast_at_{angle:g}_deg", drift)
        if angle != 0.0:
            figures += [Figure(f"white_at_{angle:g}_deg", share), contrast]
        dark = _black_figure(examined, black[0])
        cell: str | Quantity = f"< {dark.quantity.value:.2g}" if dark.bound else dark.quantity
        rows.append((f"{angle:g}°", examined.luminance(white[0].radiance), cell, share if angle else "1"))
    return Section(
        "viewing_angle", "Viewing-angle luminance (IDMS 9.4) and contrast",
        (
            "full-screen white and black at each angle, centre; white over that at the normal",
            "the luminance change ratio of IDMS 9.4 is 1 less that",
        ),
        tuple(figures), ("angle", "white (cd·m⁻²)", "black (cd·m⁻²)", "white over the normal's"), tuple(rows),
    )  # fmt: skip


WARM_UP: Final = "warm_up"
METHODS: Final[Mapping[str, Callable[[Examined], Section]]] = {
    "white": _white,
    "black": _black,
    "sequential_contrast": _sequential,
    "checkerboard_contrast": _checkerboard,
    "gamma": _gamma,
    "primaries": _primaries,
    "additivity": _additivity,
    "uniformity": _uniformity,
    "mura": _mura,
    "viewing_angle": _viewing_angle,
}


def methods_of(names: Sequence[str], *, turned: bool) -> tuple[str, ...]:
    """Return the methods to run in order: the named ones; by default all that the geometry has.

    The viewing angle needs a geometry with angles to turn the screen to. Raises UsageError if it is asked for without,
    or a name is unknown.
    """
    known = (WARM_UP, *METHODS)
    for name in names:
        if name not in known:
            raise UsageError(f"method {name!r} is unknown; choose from {', '.join(known)}")
    if "viewing_angle" in names and not turned:
        raise UsageError("viewing_angle needs angles: --geometry viewing_angle, or --angles -30,30")
    return tuple(one for one in known if (one in names if names else one != "viewing_angle" or turned))


def examine(
    examined: Examined,
    methods: Sequence[str],
    *,
    warm_up_limit_s: float,
    waiting: Callable[[float, float], None],
    progress: Callable[[int, int], None],
) -> tuple[Section, ...]:
    """Return the sections of a report.

    White is watched until it is steady in any case; how far it was from that counts in every figure from two readings.
    Where the time was up before, each method is checked by white before and after it.

    Args:
        examined: The display and how it is to be measured.
        methods: Names of the methods in order.
        warm_up_limit_s: Longest wait for the screen to settle in s.
        waiting: Called while the screen warms up with the time so far and the longest time, both in s.
        progress: Called after every method with (done, total).

    Raises DeviceError if display or camera fail, MeasurementError if a reading clips or white is hardly brighter than
    black.
    """
    bench = examined.bench
    measure_steps(bench.display, bench, REFERENCES)
    bench.display.show(WHITE)
    outcome = wait_until_steady(bench, bench.sleep, limit_s=warm_up_limit_s, progress=waiting)
    settled = replace(examined, unsettled_rel=outcome.drift_rel / 3.0**0.5)  # a rectangle of that half-width
    found = []
    for number, name in enumerate(methods):
        if name == WARM_UP:
            found.append(warm_up_section(outcome, settled))
        else:
            found.append(METHODS[name](settled) if outcome.steady else _while_drifting(name, settled))
        progress(number + 1, len(methods))
    return tuple(found)


def _while_drifting(name: str, examined: Examined) -> Section:
    """Return a method's section with the change of white meanwhile in its u: it is measured again where that is more.

    A display that warms up changes less and less, so the first change bounds the second one.
    """

    def white() -> ScreenReading:
        examined.bench.display.show(WHITE)
        return examined.bench.read()

    before, section, after = white(), METHODS[name](examined), white()
    change_rel = abs(after.radiance / before.radiance - 1.0) / 3.0**0.5  # a rectangle of that half-width
    if change_rel <= examined.unsettled_rel:
        return section
    return METHODS[name](replace(examined, unsettled_rel=change_rel))
