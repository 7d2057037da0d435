"""Report of a display: uniformity, contrast, gamma, primaries, black, warm-up, additivity, angles and mura, with u."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Ask, Notice, Progress, Result, unheard
from radiometer.api.screen import opened_screen, warming, warn_of_page
from radiometer.bench.screen import BROWSER, PRIMARIES, SIMULATED_DISPLAYS, ScreenBench, lights, primaries_of
from radiometer.data import Patch, Quantity
from radiometer.data.drawing import picture
from radiometer.data.provenance import utc_now
from radiometer.data.storage import write_text_atomic
from radiometer.errors import UsageError
from radiometer.plausible import Duration, Port, Seed
from radiometer.progress import counted
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, paragraph, section, table
from radiometer.screen.report import FIELD_SHARE, GEOMETRIES, POINTS, Examined, Geometry, Section, examine, methods_of
from radiometer.screen.run import parse_levels
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIMULATED_SIZE = (192, 128)  # px: a spot of mura covers several, and a bracket still takes a fraction of a second


@dataclass(frozen=True, eq=False, repr=False)
class DisplayReport(Result):
    """Results of the methods of a display report; all uncertainties are standard ones (k = 1).

    Attributes:
        screen: Name of the screen.
        geometry: Name of the geometry, how display and camera stood.
        conditions: Measuring conditions that all methods share, a sentence each.
        sections: Results, one section for each method.
        created: When, as ISO 8601 in UTC.
        measured_with: Camera, lens and calibration in words.
    """

    screen: str
    geometry: str
    conditions: tuple[str, ...]
    sections: tuple[Section, ...]
    created: str
    measured_with: Mapping[str, str]

    def section(self, method: str) -> Section:
        """Return the results of a method. Raises KeyError where it was not measured."""
        return {one.method: one for one in self.sections}[method]

    def to_mapping(self) -> dict[str, Any]:
        methods = {
            one.method: {
                "title": one.title,
                "conditions": one.conditions,
                "figures": {
                    each.name: {**each.quantity.to_mapping(), "bound": each.bound or None} for each in one.figures
                },
                "table": [dict(zip(one.columns, row, strict=True)) for row in one.rows],
                "notes": one.notes,
            }
            for one in self.sections
        }
        return self.plain("screen", "created", "measured_with", "geometry", "conditions", methods=methods)

    def write_report(self, path: PathLike) -> None:
        """Write a self-contained page. Raises OutputError if it cannot be written."""
        parts = [section("Measuring conditions", listed(self.conditions))]
        for one in self.sections:
            rows = [(_in_words(each.name), each.text) for each in one.figures]
            cells = [[c.text(bare=True) if isinstance(c, Quantity) else str(c) for c in row] for row in one.rows]
            parts.append(
                section(
                    one.title,
                    listed(one.conditions),
                    table(("result", "k = 2"), rows),
                    "" if one.picture is None else picture(partial(_drawn, one.picture), one.title),
                    folded("All readings, k = 2", table(one.columns, cells)) if cells else "",
                    *(paragraph(note, "flag") for note in one.notes),
                )
            )
        ordered = sorted(self.sections, key=lambda one: one.method == "warm_up")  # warming up is no result
        main = [f"{_in_words(one.method)} {one.figures[0].text}" for one in ordered]
        outcome = f"{', '.join(main[:3])}{', …' if len(main) > 3 else ''} (k = 2)"
        known = self.measured_with
        origin = Origin(
            moment(self.created), known["camera"], known["lens"], known["calibration"], box=self.screen,
            protocol=f"geometry {self.geometry}",
        )  # fmt: skip
        title = f"display {self.screen}"
        write_text_atomic(Path(path), page(title, outcome, parts, kind="display report", origin=origin))

    def lines(self) -> list[str]:
        """Return every figure and note in plain lines."""
        found = list[str]()
        for one in self.sections:
            found.append(f"{one.title}  (± by k = 2)")
            found += [f"  {_in_words(each.name):<28} {each.text}" for each in one.figures]
            found += [f"  note: {note}" for note in one.notes]
        return found

    def __str__(self) -> str:
        shown = [f"{one.method} {one.figures[0].text}" for one in self.sections]
        return f"{self.screen}: {', '.join(shown)} (k = 2)"


def _in_words(name: str) -> str:
    return name.replace("_", " ").replace(" percent", " %").replace(" deg", "°")


def _drawn(mura: Array, axes: Axes) -> Axes:
    largest = float(abs(mura).max()) or 1.0
    shown = axes.imshow(mura, cmap="RdBu_r", vmin=-largest, vmax=largest)
    axes.figure.colorbar(shown, ax=axes, label="band-passed, % of the shading")
    axes.set(xlabel="x (px)", ylabel="y (px)")
    return axes


def screen_report(
    out: PathLike | None = None,
    display: str = BROWSER,
    *,
    name: str | None = None,
    methods: Sequence[str] = (),
    geometry: str = "direct",
    angles: Sequence[float] | None = None,
    points: int = 13,
    checkers: tuple[int, int] = (4, 4),
    levels: str = "17",
    area: PatchLike | None = None,
    warm_up_s: Duration = 900.0,
    white: str = "white_led",
    primaries: str | None = None,
    camera: str | None = None,
    bench: PathLike | None = None,
    calibration: PathLike | None = None,
    port: Port = 0,
    seed: Seed = 1,
    ask: Ask | None = None,
    announce: Callable[[str], None] = lambda url: None,
    notice: Notice = unheard,
    progress: Progress | None = None,
) -> DisplayReport:
    """Measure a display by methods of the Information Display Measurements Standard, each figure with its uncertainty.

    Each method has its measuring conditions; those of the standard carry its section.

    Examples:
        >>> import radiometer as rm
        >>> rm.screen_report("lcd.html", "lcd", methods=["white", "black"], warm_up_s=0)
        <DisplayReport lcd: white 2... ± ... cd·m⁻², black ... (k = 2)>

    Args:
        out: Page to write; none by default.
        methods: Some of warm_up, white, black, sequential_contrast, checkerboard_contrast, gamma, primaries,
            additivity, uniformity, mura and viewing_angle; all that the geometry has by default.
        geometry: "direct", "viewing_angle" or "near_eye".
        angles: Angles from the normal in degrees; the geometry's by default.
        points: Places of the uniformity: 9, 13 or 25.
        checkers: Columns and rows of the checkerboard, an even number of fields.
        levels: Greys of the gamma: a count such as "17", or a list such as "0,64,128,255".
        area: Where the camera sees the whole screen; all of a simulated camera's picture by default.
        seed: Seed of a simulated camera's noise.
        ask: Asks a person to turn the screen and returns once it is done; needed for angles of a real screen.
        notice: Gets warnings of the page.
        progress: Called after every method.

    Raises:
        UsageError: If a method, geometry or number is unknown, or a real screen's area is not stated.
        RadiometerError: As `screen_calibrate`, which has the other arguments.
    """
    if geometry not in GEOMETRIES:
        raise UsageError(f"geometry {geometry!r} is unknown; choose {', '.join(GEOMETRIES)}")
    known = GEOMETRIES[geometry]
    turned = tuple(known.angles_deg if angles is None else angles)
    chosen = methods_of(methods, turned=any(turned))
    _refuse(points, checkers, turned)
    if display not in SIMULATED_DISPLAYS and area is None:
        raise UsageError("where does the camera see the whole screen? Say --area X,Y,W,H in pixels of its picture")
    greys = parse_levels(levels)
    if "viewing_angle" in chosen and display not in SIMULATED_DISPLAYS and ask is None:
        raise UsageError("a real screen is turned by hand: run this at a terminal, or leave viewing_angle out")
    stated = primaries if primaries or display not in SIMULATED_DISPLAYS else primaries_of(display, PRIMARIES, None)
    lamps = lights(white, stated)
    with opened_screen(
        display, bench, camera, calibration, as_patch(area), port, announce, seed=seed, simulated_size=_SIMULATED_SIZE
    ) as opened:
        size = opened.instrument.camera.capabilities
        where = as_patch(area) or Patch(0, 0, size.width, size.height)
        conditions = (f"geometry {geometry}", *_conditions(opened, known, where, white, stated))
        turn = opened.turn or (lambda angle: (ask or unheard)(f"turn the screen to {angle:g}° from its normal"))
        examined = Examined(opened, where, lamps, turn, points, checkers, greys, turned)
        found = examine(
            examined, chosen, warm_up_limit_s=warm_up_s, waiting=warming(progress),
            progress=counted(progress, "methods of the report"),
        )  # fmt: skip
        warn_of_page(opened.display, notice)
        with_what = opened.measured_with
    report = DisplayReport(name or display, geometry, conditions, found, utc_now(), with_what)
    if out is not None:
        report.write_report(out)
    return report


def _refuse(points: int, checkers: tuple[int, int], angles: Sequence[float]) -> None:
    if points not in POINTS:
        raise UsageError(f"--points {points}: choose {', '.join(map(str, POINTS))}")
    if min(checkers) < 1 or max(checkers) > 16 or checkers[0] * checkers[1] % 2:
        raise UsageError(f"--checkers {checkers[0]}x{checkers[1]}: 1 to 16 columns and rows, an even number of fields")
    for angle in angles:
        if not abs(angle) <= 80.0:
            raise UsageError(f"--angles {angle:g}: at most 80° from the normal")


def _conditions(
    opened: ScreenBench, geometry: Geometry, area: Patch, white: str, primaries: str | None
) -> tuple[str, ...]:
    """Return what all methods share, and what of the geometry is in doubt."""
    camera, lens, known = opened.instrument.camera, opened.instrument.lens, opened.instrument.calibration
    model = " ".join(word for word in (camera.identity.vendor, camera.identity.model, camera.identity.serial) if word)
    scale = f"{known.scale.reference or 'as stated'}, {moment(known.created)}" if known else "none: values are relative"
    lines = [
        *geometry.conditions,
        f"camera {model}; calibration: {scale}",
        f"the screen fills {area.width} × {area.height} pixels at {area.x},{area.y} of the camera's picture",
        f"measuring fields have {100 * FIELD_SHARE:g} % of the screen's height",
        f"luminance assumes the spectrum {white} for grey"
        + (f", {primaries} for the primaries" if primaries else "")
        + "; u of each luminance holds how displays differ from it",
        "light of the room is in every figure; the room is assumed dark",
    ]
    if lens.focal_length_mm and lens.f_number:
        pupil_mm = lens.focal_length_mm / lens.f_number
        lines.append(f"entrance pupil of the lens {pupil_mm:.2g} mm")
        if geometry.pupil_mm is not None and not geometry.pupil_mm[0] <= pupil_mm <= geometry.pupil_mm[1]:
            low, high = geometry.pupil_mm
            lines.append(f"doubt: near_eye needs an entrance pupil of {low:g} to {high:g} mm, as an eye has")
    elif geometry.pupil_mm is not None:
        lines.append("doubt: focal length or f-number of the lens is unknown, so the entrance pupil is as well")
    return tuple(lines)
