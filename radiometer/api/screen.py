"""A screen as a calibrated light source: calibrated, looked up, exported, imported."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Drawn, Notice, Progress, Result, unheard
from radiometer.bench.screen import BROWSER, SIMULATED_SIZE, ScreenBench, lights, open_screen_bench, primaries_of
from radiometer.data import Quantity
from radiometer.data.capture_set import refuse_inputs
from radiometer.data.drawing import check_plot_name, new_axes
from radiometer.data.event_journal import kept_until_written
from radiometer.data.statements import StatementMap
from radiometer.data.storage import check_outputs
from radiometer.devices import Display
from radiometer.errors import RadiometerError, UsageError
from radiometer.numbers import unit_text, with_u
from radiometer.plausible import (
    Count,
    Duration,
    Gamma,
    PatchSize,
    PixelPitch,
    Port,
    Positive,
    RelativeUncertainty,
    Seed,
)
from radiometer.progress import counted
from radiometer.reporting.origin import moment
from radiometer.reporting.pictures import label
from radiometer.screen.calibration import LUMINANCE, RADIANCE, SCOTOPIC, ChannelCurve, ScreenCalibration
from radiometer.screen.calibration_run import COVERAGE, Options, Verified, calibrate_screen, verify_screen
from radiometer.screen.exports import EXPORTS, NOTES, argyll_line, check_profile, draw_curves, write_export
from radiometer.screen.measured_elsewhere import METER_U_REL, chromaticities_in, imported, read_screen_readings
from radiometer.screen.run import checks_in_words, parse_levels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RUN_FORMAT: Final = "radiometer-screen-run/1"  # of the journal of an unfinished calibration
# Names of what a level is looked up by, as the command line writes them.
_UNITS: Final[Mapping[str, str]] = {"cd": LUMINANCE, "scotopic": SCOTOPIC, "W": RADIANCE}


@dataclass(frozen=True, repr=False)
class CalibratedScreen(Drawn):
    """A screen's calibration and where it stands.

    Attributes:
        calibration: Its channels, checks and provenance.
        file: The file; None where none was written.
        taken: What was made of the file that it was imported from, a line each.
        doubts: What that file leaves open and how it was read, a line each.
        left_out: Channels of that file whose spectra are not known.
    """

    calibration: ScreenCalibration
    file: Path | None
    taken: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        report = {"taken": list(self.taken), "doubts": list(self.doubts)} if self.taken or self.doubts else {}
        return {"file": None if self.file is None else str(self.file), **report, **self.calibration.to_mapping()}

    def luminance_range(self, curve: ChannelCurve) -> tuple[Quantity, Quantity]:
        """Return the luminance of a channel's darkest and brightest level in cd·m⁻²."""
        return curve.at(curve.levels[0], LUMINANCE), curve.at(curve.levels[-1], LUMINANCE)

    def detection_limit(self, curve: ChannelCurve) -> float | None:
        """Return the luminance in cd·m⁻² that the darkest level is below; None where it was measured."""
        lost = curve.radiance_is_lost(curve.levels[0])
        return curve.detection_limit * curve.efficacy(LUMINANCE) if lost else None

    def checks_in_words(self) -> dict[str, str]:
        """Return what warm-up, drift, flicker, uniformity and additivity showed, by name."""
        return checks_in_words(self.calibration.checks)

    def argyll_lines(self) -> list[str]:
        """Return the line that ArgyllCMS's spotread prints, for every level measured."""
        return [
            argyll_line(self.calibration, name, curve.at(n, LUMINANCE).value)
            for name, curve in self.calibration.channels.items()
            for n in curve.levels
        ]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the luminance of every channel over the level, with its k = 2 band."""
        where = axes if axes is not None else new_axes()
        draw_curves(where, self.calibration)
        where.set_title(f"{label(self.calibration.name)}, {moment(self.calibration.created)}", fontsize="medium")
        return where

    def __str__(self) -> str:
        known = self.calibration.channels.values()
        ends = ", ".join(f"{one.name} to {self.luminance_range(one)[1].value:.4g} cd·m⁻²" for one in known)
        return f"{self.calibration.name}: {ends}"


@dataclass(frozen=True, repr=False)
class ScreenLevel(Result):
    """The level that shows a requested value.

    Attributes:
        channel: Name of the channel.
        level: The level.
        shown: What it shows, with its standard uncertainty.
        target: What was asked for, in the same unit.
    """

    channel: str
    level: int
    shown: Quantity
    target: float

    def __str__(self) -> str:
        return f"level {self.level} of {self.channel} shows {self.shown.value:.5g} {unit_text(self.shown.unit)}"


def screen_calibrate(
    out: PathLike | None = None,
    display: str = BROWSER,
    *,
    name: str | None = None,
    levels: str = "33",
    quick: bool = False,
    channels: Sequence[str] = ("grey",),
    repeats: Count = 1,
    size: PatchSize = 1.0,
    pixel_mm: PixelPitch | None = None,
    chromaticities: PathLike | None = None,
    warm_up_s: Duration = 900.0,
    white: str = "white_led",
    primaries: str | None = None,
    camera: str | None = None,
    bench: PathLike | None = None,
    calibration: PathLike | None = None,
    patch: PatchLike | None = None,
    port: Port = 0,
    export: Sequence[str] = (),
    plot: PathLike | None = None,
    seed: Seed = 1,
    force: bool = False,
    announce: Callable[[str], None] = lambda url: None,
    notice: Notice = unheard,
    progress: Progress | None = None,
) -> CalibratedScreen:
    """Measure which level of a screen gives which radiance and luminance, with uncertainty.

    A journal next to `out` keeps every patch until `out` is written. After an interruption the same call goes on there.

    Examples:
        >>> import radiometer as rm
        >>> rm.screen_calibrate("screen.yaml", "lcd", quick=True)
        <CalibratedScreen lcd: grey to 2... cd·m⁻²>

    Args:
        out: Calibration file to write.
        display: "browser", or a simulated one: "lcd", "pwm_lcd", "oled".
        name: Name of the screen; the display's by default.
        levels: "all", "quick", a count such as "33", or a list such as "0,16,255".
        quick: Darkest, brightest and five levels between.
        channels: "grey", "red", "green", "blue" or some of them.
        repeats: Readings of every patch.
        size: Patch size as a share of the screen's.
        pixel_mm: Distance of two pixels in mm, for an adaptation test.
        chromaticities: Where a colorimeter's chromaticities of this screen are: a .ti3, or an earlier calibration. By
            default those of the calibration that is replaced.
        warm_up_s: Longest wait for the screen to settle in s.
        white: Spectrum assumed for grey.
        primaries: Spectra of red, green and blue: a display type, or a CSV of them.
        camera: Camera by id, serial number or address; a browser's page needs it, or a bench.
        bench: Bench file; before a simulated display the simulated bench by default.
        calibration: The camera's calibration; the bench's by default.
        patch: Where the camera sees the patch.
        port: Port of the page; 0 for any free one.
        export: Forms to write as well, such as "psychopy" or "ti3".
        plot: Picture of the curves to draw: .png, .pdf or .svg.
        seed: Seed of the random order.
        force: Replace files that exist.
        announce: Called with the page's address.
        notice: Gets warnings of the page, and where patches are kept after an interruption.
        progress: Called after every patch.

    Raises:
        UsageError: If display, channel, level or form is unknown, or no camera looks at a browser's page. Also if
            `out` holds a journal of another calibration.
        CalibrationError: If the camera has no absolute calibration.
        MeasurementError: If white clips or is hardly brighter than black; before the screen warms up.
        DeviceError: If display or camera fails.
        OutputError: If a file cannot be written.
    """
    kinds = _kinds(export)
    if out is not None:
        check_outputs(*_export_files(kinds, Path(out)), force=force)
        read = [Path(one) for one in (bench, calibration, primaries) if isinstance(one, str | os.PathLike)]
        refuse_inputs(_export_files(kinds, Path(out)), read)
    if plot is not None:
        check_plot_name(Path(plot))
    target = Path(out) if out is not None else None
    known_xy = _known_chromaticities(chromaticities, target, name or display, notice)
    if "icc" in kinds:
        check_profile(name or display, known_xy)
    options = Options(
        name=name or display, levels=parse_levels("quick" if quick else levels), channels=tuple(channels),
        repeats=repeats, patch_size=size, warm_up_limit_s=warm_up_s, seed=seed, pixel_mm=pixel_mm,
        chromaticities=known_xy,
    )  # fmt: skip
    lamps = lights(white, primaries_of(display, options.channels, primaries))
    with opened_screen(display, bench, camera, calibration, patch, port, announce) as opened:
        serial = opened.instrument.camera.description.serial or ""
        asked = asdict(options) | {"display": display, "camera": serial, **opened.measured_with}
        known = opened.instrument.calibration
        asked |= {"patch": astuple(opened.instrument.patch), "content": None if known is None else known.content_hash()}
        asked["spectra"] = {name: light.spectrum for name, light in lamps.items()}
        with kept_until_written(target, RUN_FORMAT, asked, notice) as journal:
            found = calibrate_screen(
                opened, options, lamps, journal=journal, progress=_advance(progress), waiting=warming(progress)
            )
            warn_of_page(opened.display, notice)
            found = replace(found, instrument=serial, measured_with=opened.measured_with)
            if target is not None:
                found.write(target)
                _exports(found, kinds, target, notice)
    done = CalibratedScreen(found, target)
    if plot is not None:
        done.write_plot(plot)
    return done


def _known_chromaticities(
    stated: PathLike | None, replaced: Path | None, name: str, notice: Notice
) -> Mapping[str, tuple[float, float]]:
    """Return the chromaticities of a screen: those stated, else those of its calibration that is replaced."""
    if stated is not None:
        return chromaticities_in(Path(stated))
    if replaced is None or not replaced.is_file():
        return {}
    try:
        before = ScreenCalibration.read(replaced)
    except RadiometerError:  # it is replaced whatever it is
        return {}
    if before.name != name or not before.chromaticities:
        return {}
    notice(
        f"{replaced}: its chromaticities of {', '.join(before.chromaticities)} are kept; --chromaticities replaces them"
    )
    return before.chromaticities


@dataclass(frozen=True, repr=False)
class VerifiedScreen(Result):
    """A screen's calibration compared with its screen as it is now."""

    calibration: ScreenCalibration
    verified: Verified

    @property
    def holds(self) -> bool:
        """Return whether the calibration holds at every level that was measured."""
        return self.verified.holds

    def to_mapping(self) -> dict[str, Any]:
        names = ("channel", "level", "calibrated", "measured", "difference", "agrees")
        levels = [{name: getattr(one, name) for name in names} for one in self.verified.levels]
        known = {"screen": self.calibration.name, "calibrated": self.calibration.created}
        return self.plain("holds", **known, coverage_factor=COVERAGE, levels=levels)

    def lines(self) -> list[str]:
        """Return each level as calibrated and as measured, then the verdict."""
        rows = []
        for one in self.verified.levels:
            known, now, gap = (
                with_u(part.value, COVERAGE * part.u, part.unit)
                for part in (one.calibrated, one.measured, one.difference)
            )
            word = "agrees" if one.agrees else "DIFFERS"
            rows.append(f"{one.channel:<6} {one.level:>3}  {known} calibrated, {now} now, difference {gap}: {word}")
        verdict = (
            "the calibration holds at every level measured (k = 2)"
            if self.holds
            else "the calibration no longer holds: calibrate again, with settings and room as they are used"
        )
        return [*rows, verdict]

    def __str__(self) -> str:
        return f"{self.calibration.name}: {'holds' if self.holds else 'no longer holds'}"


def screen_verify(
    calibration: PathLike | ScreenCalibration,
    display: str = BROWSER,
    *,
    levels: str = "0,64,128,192,255",
    size: PatchSize = 1.0,
    warm_up_s: Duration = 900.0,
    camera: str | None = None,
    bench: PathLike | None = None,
    camera_calibration: PathLike | None = None,
    patch: PatchLike | None = None,
    port: Port = 0,
    announce: Callable[[str], None] = lambda url: None,
    notice: Notice = unheard,
    progress: Progress | None = None,
) -> VerifiedScreen:
    """Measure some levels of a calibrated screen again, and find whether the calibration still holds.

    `radiometer screen verify` ends with exit code 1 where it does not.

    Examples:
        >>> import radiometer as rm
        >>> screen = rm.screen_calibrate(display="lcd", quick=True).calibration
        >>> rm.screen_verify(screen, "lcd").holds
        True

    Args:
        calibration: Screen calibration, or its file.
        camera_calibration: The camera's calibration; the bench's by default.
        notice: Gets warnings of the page.

    Raises:
        RadiometerError: As `screen_calibrate`, which has the other arguments.
    """
    known = calibration if isinstance(calibration, ScreenCalibration) else ScreenCalibration.read(Path(calibration))
    chosen = parse_levels(levels)
    with opened_screen(display, bench, camera, camera_calibration, patch, port, announce) as opened:
        found = verify_screen(
            opened, known, chosen, warm_up_limit_s=warm_up_s, patch_size=size,
            same_meter=dict(known.measured_with) == opened.measured_with, progress=_advance(progress),
            waiting=warming(progress),
        )  # fmt: skip
        warn_of_page(opened.display, notice)
    return VerifiedScreen(known, found)


def opened_screen(
    display: str,
    bench: PathLike | None,
    camera: str | None,
    calibration: PathLike | None,
    patch: PatchLike | None,
    port: int,
    announce: Callable[[str], None],
    *,
    seed: int = 1,
    simulated_size: tuple[int, int] = SIMULATED_SIZE,
) -> AbstractContextManager[ScreenBench]:
    """Return a context with an open display and the camera before it.

    Args:
        display: "browser", or a simulated one.
        bench: Bench file.
        camera: Camera by name.
        calibration: The camera's calibration; the bench's by default.
        patch: Where the camera sees the patch.
        port: Port of the page.
        announce: Called with the page's address.
        seed: Seed of a simulated camera's noise.
        simulated_size: Width and height of a simulated camera's picture in pixels.

    Raises:
        UsageError: If no camera looks at a browser's page.
    """
    if display == BROWSER and camera is None and bench is None:
        raise UsageError(
            "a page in a browser is shown on a real screen, which the simulated camera does not see: name --camera or "
            "--bench; or simulate the screen too, with --display lcd, pwm_lcd or oled"
        )
    known_bench, known_calibration = (Path(one) if one else None for one in (bench, calibration))
    return open_screen_bench(
        display, bench=known_bench, camera=camera, calibration=known_calibration, patch=as_patch(patch), port=port,
        announce=announce, seed=seed, simulated_size=simulated_size,
    )  # fmt: skip


def _advance(progress: Progress | None) -> Callable[[int, int, object], None]:
    shown = counted(progress, "measuring the screen")
    return lambda done, total, _step: shown(done, total)


def warming(progress: Progress | None) -> Callable[[float, float], None]:
    """Return what is called while a screen warms up."""
    shown = counted(progress, "screen warms up, at most so many s")
    return lambda waited_s, longest_s: shown(round(waited_s), round(longest_s))


def warn_of_page(display: Display, notice: Notice) -> None:
    """Hand on what on the page's side may falsify what it shows."""
    warnings = getattr(display, "warnings", None)
    for warning in warnings() if warnings else ():
        notice(f"warning: {warning}")


def screen_level(
    calibration: PathLike | ScreenCalibration, target: float, unit: str = "cd", channel: str = "grey"
) -> ScreenLevel:
    """Find which level shows a requested luminance or radiance.

    Examples:
        >>> import radiometer as rm
        >>> screen = rm.screen_calibrate(display="lcd", quick=True).calibration
        >>> rm.screen_level(screen, 50.0).level in range(1, 255)
        True

    Args:
        calibration: Screen calibration, or its file.
        target: Requested value.
        unit: "cd", "scotopic" (both cd·m⁻²) or "W" (W·sr⁻¹·m⁻²).
        channel: "grey", "red", "green" or "blue".

    Raises:
        UsageError: If unit or channel is unknown.
        CalibrationError: If the screen does not reach the value.
    """
    if unit not in _UNITS:
        raise UsageError(f"--unit {unit!r}: choose {', '.join(_UNITS)}")
    known = calibration if isinstance(calibration, ScreenCalibration) else ScreenCalibration.read(Path(calibration))
    curve = known.channel(channel)
    level = curve.level_for(target, _UNITS[unit])
    return ScreenLevel(channel, level, curve.at(level, _UNITS[unit]), target)


def screen_export(
    calibration: PathLike,
    kinds: Sequence[str],
    out: PathLike | None = None,
    *,
    force: bool = False,
    notice: Notice = unheard,
) -> list[Path]:
    """Write a screen calibration in the forms of other programs.

    Examples:
        >>> import radiometer as rm
        >>> done = rm.screen_calibrate("lcd.yaml", "lcd", quick=True)
        >>> rm.screen_export("lcd.yaml", ["csv"])
        [PosixPath('lcd.csv')]

    Args:
        calibration: Screen calibration file.
        kinds: "psychopy", "ti3", "csv", "inverse", "vcgt", "cal", "icc", "page" or some of them.
        out: Folder; where the calibration is by default.
        force: Replace files that exist.
        notice: Gets what a form assumes and cannot hold itself.

    Raises:
        UsageError: If no form is named, or one that is unknown.
        CalibrationError: If an ICC profile is asked for and a chromaticity is unknown.
        MissingLibrary: If an ICC profile is asked for and imagecodecs is not installed.
        OutputError: If a file cannot be written.
    """
    chosen = _kinds(kinds)
    if not chosen:
        raise UsageError(f"name at least one form: {','.join(EXPORTS)}")
    file = Path(calibration)
    base = Path(out or file.parent) / file.name
    check_outputs(*_export_files(chosen, base), force=force)
    refuse_inputs(_export_files(chosen, base), [file])
    return _exports(ScreenCalibration.read(file), chosen, base, notice)


def screen_import(
    file: PathLike,
    out: PathLike | None = None,
    *,
    name: str | None = None,
    white: str = "white_led",
    primaries: str | None = None,
    meter_u_rel: RelativeUncertainty = METER_U_REL,
    white_luminance: Positive | None = None,
    gamma: Gamma = 2.2,
    mapped: StatementMap | Sequence[str] = (),
) -> CalibratedScreen:
    """Make a screen calibration of measurements made elsewhere, with their uncertainty.

    Examples:
        >>> import radiometer as rm
        >>> rm.screen_import("luminances.csv", "elsewhere.yaml")
        <CalibratedScreen luminances: grey to 120 cd·m⁻²>

    Args:
        file: ArgyllCMS .ti3 or .cal, pacsdisplay uLR, or a table of level and luminance in cd·m⁻².
        out: Calibration file to write.
        name: Name of the screen; the file's own by default.
        white: Spectrum assumed for grey.
        primaries: Spectra of red, green and blue: a display type, or a CSV of them.
        meter_u_rel: Relative standard uncertainty of the meter's scale.
        white_luminance: Luminance of white in cd·m⁻², which a .cal does not hold.
        gamma: Exponent that a .cal was made for.
        mapped: Column of a table and its unit: "level=drive:8bit", "luminance=Y:cd/m2"; or a YAML file.

    Raises:
        UnsettledError: If a table's columns or units are not known.
        InputError: If the file cannot be read or holds too few levels.
        OutputError: If the calibration cannot be written.
    """
    stated = StatementMap.of(mapped)
    readings = read_screen_readings(Path(file), white_luminance, gamma, stated)
    if name is not None:
        readings = replace(readings, name=name)
    found = imported(readings, lights(white, primaries), meter_u_rel, Path(file).name)
    if out is not None:
        found.write(Path(out))
    left_out = tuple(sorted(set(readings.primaries) - set(found.channels)))
    place = Path(out) if out is not None else None
    return CalibratedScreen(found, place, tuple(readings.taken), tuple(readings.doubts), left_out)


def _kinds(names: Sequence[str]) -> list[str]:
    for kind in names:
        if kind not in EXPORTS:
            raise UsageError(f"export {kind!r} is unknown; choose from {', '.join(EXPORTS)}")
    return list(names)


def _exports(calibration: ScreenCalibration, kinds: list[str], next_to: Path, notice: Notice) -> list[Path]:
    files = _export_files(kinds, next_to)
    for kind, path in zip(kinds, files, strict=True):
        write_export(calibration, kind, path)
        for line in NOTES[kind](calibration) if kind in NOTES else ():
            notice(line)
    return files


def _export_files(kinds: list[str], base: Path) -> list[Path]:
    return [base.with_suffix(EXPORTS[kind][1]) for kind in kinds]
