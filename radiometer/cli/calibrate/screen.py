"""`radiometer screen`: calibrate a screen, look up levels, export to other programs, import from them."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_numbers, parse_patch
from radiometer.cli.console import console, note, progress
from radiometer.cli.function import command_of
from radiometer.cli.options import (
    BenchOption,
    CalibrationOption,
    CameraOption,
    JsonOption,
    PrimariesOption,
    SeedOption,
    WhiteOption,
    command_group,
    relative_option,
    words,
)
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import below, rounded, upper_limit, with_u
from radiometer.plausible import Count, Duration, Gamma, PatchSize, PixelPitch, Port, Positive

if TYPE_CHECKING:
    from radiometer import DisplayReport

app = command_group("Calibrate a screen as a light source, and use the calibration.")
ScreenFile = Annotated[Path, typer.Argument(help="Screen calibration file.")]
OutOption = Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write.")]


@app.command()
@writes("out", "plot")
def calibrate(
    out: OutOption = Path("screen.yaml"),
    display: Annotated[str, typer.Option(help="browser, or a simulated one: lcd, pwm_lcd, oled.")] = "browser",
    name: Annotated[str | None, typer.Option(help="What the screen is called; the display's name by default.")] = None,
    levels: Annotated[str, typer.Option(help="all, quick, a count such as 33, or a list such as 0,16,255.")] = "33",
    quick: Annotated[bool, typer.Option("--quick", help="Darkest, brightest and five levels between.")] = False,
    channels: Annotated[str, typer.Option(help="Channels: grey,red,green,blue or some of them.")] = "grey",
    repeats: Annotated[Count, typer.Option(help="Readings of every patch.")] = 1,
    size: Annotated[PatchSize, typer.Option(help="Patch size as a share of the screen's.")] = 1.0,
    pixel_mm: Annotated[PixelPitch | None, typer.Option(help="Distance of two pixels in mm, for `adapt run`.")] = None,
    chromaticities: Annotated[
        Path | None,
        typer.Option(
            help="Colorimeter's chromaticities of this screen: a .ti3, or an earlier calibration; by default those of "
            "the calibration that is replaced."
        ),
    ] = None,
    warm_up: Annotated[Duration, typer.Option(help="Longest wait for the screen to settle in s.")] = 900.0,
    white: WhiteOption = "white_led",
    primaries: PrimariesOption = None,
    camera: CameraOption = None,
    bench: BenchOption = None,
    calibration: CalibrationOption = None,
    patch: Annotated[str | None, typer.Option(help="Where the camera sees the patch: X,Y,W,H in pixels.")] = None,
    port: Annotated[Port, typer.Option(help="Port of the page; 0 for any free one.")] = 0,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in this machine's browser.")] = False,
    export: Annotated[str, typer.Option(help="Also write: psychopy,ti3,csv,inverse,vcgt,cal,icc,page.")] = "",
    plot: Annotated[Path | None, typer.Option(help="Picture of the curves: .png, .pdf or .svg.")] = None,
    argyll: Annotated[bool, typer.Option("--argyll", help="Print spotread's line for every level measured.")] = False,
    seed: SeedOption = 1,
    json: JsonOption = False,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Measure which level of a screen gives which radiance and luminance, with uncertainty."""

    def announce(url: str) -> None:
        note("open this address on the screen to be measured, then press Start:", f"  {url}")
        if open_browser:
            webbrowser.open(url)

    with progress(shown=not json) as shown:
        found = rm.screen_calibrate(
            out, display, name=name, levels=levels, quick=quick, channels=words(channels), repeats=repeats, size=size,
            pixel_mm=pixel_mm, chromaticities=chromaticities, warm_up_s=warm_up, white=white, primaries=primaries,
            camera=camera, bench=bench, calibration=calibration, patch=parse_patch(patch), port=port,
            export=words(export), plot=plot, seed=seed, force=force, announce=announce, notice=note, progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
        return
    for line in found.argyll_lines() if argyll else ():
        print(line)
    for curve in found.calibration.channels.values():
        _print_channel(found, curve)
    for check, finding in found.checks_in_words().items():
        line = f"{check:<10} {finding}"
        console().print(f"[yellow]{line}[/yellow]" if check == "flicker" else line)
    _print_end(found)


def _show_report(found: DisplayReport) -> None:
    for line in found.lines():
        console().print(line)


def _fields(text: str) -> tuple[int, int]:
    columns, cross, rows = text.lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal()):
        raise UsageError(f"--checkers {text!r}: expected COLUMNSxROWS such as 4x4")
    return int(columns), int(rows)


_report = command_of(
    "screen_report", _show_report, files=("out",), out=typer.Option("--out", "-o"), white=WhiteOption,
    methods=typer.Option(parser=words, metavar="NAME,NAME,…"),
    angles=typer.Option(
        parser=lambda text: parse_numbers(text, "--angles", "degrees such as -30,30"), metavar="DEG,DEG,…"
    ),
    checkers=typer.Option(parser=_fields, metavar="COLUMNSxROWS"), defaults={"checkers": "4x4", "display": "browser"},
    area=typer.Option(parser=parse_patch, metavar="X,Y,W,H"), warm_up_s=typer.Option("--warm-up"),
    primaries=PrimariesOption, camera=CameraOption, bench=BenchOption, calibration=CalibrationOption, seed=SeedOption,
)  # fmt: skip
app.command("report")(_report)


@app.command()
def verify(
    calibration: ScreenFile,
    display: Annotated[str, typer.Option(help="browser, or a simulated one: lcd, pwm_lcd, oled.")] = "browser",
    levels: Annotated[str, typer.Option(help="all, quick, a count such as 33, or a list.")] = "0,64,128,192,255",
    size: Annotated[PatchSize, typer.Option(help="Patch size as a share of the screen's.")] = 1.0,
    warm_up: Annotated[Duration, typer.Option(help="Longest wait for the screen to settle in s.")] = 900.0,
    camera: CameraOption = None,
    bench: BenchOption = None,
    camera_calibration: Annotated[
        Path | None, typer.Option(help="Calibration of the camera; the bench's by default.")
    ] = None,
    patch: Annotated[str | None, typer.Option(help="Where the camera sees the patch: X,Y,W,H in pixels.")] = None,
    port: Annotated[Port, typer.Option(help="Port of the page; 0 for any free one.")] = 0,
    json: JsonOption = False,
) -> None:
    """Measure some levels of a calibrated screen again: does its calibration still hold?

    Exit code 1 where it does not.
    """
    with progress(shown=not json) as shown:
        found = rm.screen_verify(
            calibration, display, levels=levels, size=size, warm_up_s=warm_up, camera=camera, bench=bench,
            camera_calibration=camera_calibration, patch=parse_patch(patch), port=port, notice=note, progress=shown,
            announce=lambda url: note("open this address on the screen to be measured, then press Start:", f"  {url}"),
        )  # fmt: skip
    if json:
        print(found.to_json())
    else:
        for line in found.lines():
            console().print(line)
    if not found.holds:
        raise typer.Exit(1)


@app.command()
def level(
    calibration: ScreenFile,
    target: Annotated[float, typer.Argument(help="Wanted value.")],
    unit: Annotated[str, typer.Option(help="cd, scotopic or W (per sr and m2).")] = "cd",
    channel: Annotated[str, typer.Option(help="grey, red, green or blue.")] = "grey",
    json: JsonOption = False,
) -> None:
    """Print the level that shows a requested luminance or radiance."""
    found = rm.screen_level(calibration, target, unit, channel)
    if json:
        print(found.to_json())
        return
    value, u = found.shown.value, found.shown.u
    known = value > 2 * u  # below it only a limit is known
    shown = with_u(value, 2 * u, found.shown.unit, k=2) if known else below(upper_limit(value, u), found.shown.unit)
    console().print(f"level {found.level} of {channel} shows {shown}")


@app.command("export")
@writes()
def export_command(
    calibration: ScreenFile,
    kinds: Annotated[str, typer.Argument(help="psychopy,ti3,csv,inverse,vcgt,cal,icc,page or some of them.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder; that of the calibration by default.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Write a calibration in the forms of other programs."""
    for written in rm.screen_export(calibration, words(kinds), out, force=force, notice=note):
        console().print(f"wrote {written}")


@app.command("import")
@writes("out")
def import_command(
    file: Annotated[Path, typer.Argument(help="ArgyllCMS .ti3 or .cal, pacsdisplay uLR, or a table: level, cd·m⁻².")],
    out: OutOption = Path("screen.yaml"),
    name: Annotated[str | None, typer.Option(help="What the screen is called; as the file says by default.")] = None,
    white: WhiteOption = "white_led",
    primaries: PrimariesOption = None,
    meter_u_rel: Annotated[float, relative_option("--meter-u-rel", "Relative u (k = 1) of the meter's scale")] = 0.04,
    white_luminance: Annotated[
        Positive | None, typer.Option(help="Luminance of white in cd·m⁻², which a .cal does not hold.")
    ] = None,
    gamma: Annotated[Gamma, typer.Option(help="Exponent that a .cal was made for.")] = 2.2,
    mapped: Annotated[
        list[str] | None,
        typer.Option(
            "--map", help="Column of a table and its unit: level=drive:8bit, luminance=Y:cd/m2; or a YAML file."
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Make a screen calibration of measurements made elsewhere, with their uncertainty."""
    found = rm.screen_import(
        file, out, name=name, white=white, primaries=primaries,
        meter_u_rel=meter_u_rel, white_luminance=white_luminance, gamma=gamma,
        mapped=mapped or (),
    )  # fmt: skip
    if json:
        print(found.to_json())
        return
    for line in found.taken:
        note(f"taken: {line}")
    for line in found.doubts:
        note(f"doubt: {line}")
    if found.left_out:
        names = ", ".join(found.left_out)
        note(f"{names} left out: their spectra are not known; --primaries names a display type or a CSV")
    for curve in found.calibration.channels.values():
        _print_channel(found, curve)
    _print_end(found)


def _print_end(found: rm.CalibratedScreen) -> None:
    for assumption in found.calibration.provenance.assumptions:
        console().print(f"assumed    {assumption}")
    console().print(f"wrote {found.file}")


def _print_channel(found: rm.CalibratedScreen, curve: Any) -> None:
    out = console()
    (black, white), limit = found.luminance_range(curve), found.detection_limit(curve)
    out.print(f"[bold]{curve.name}[/bold]: {len(curve.levels)} levels")
    out.print(f"  brightest  {with_u(white.value, 2 * white.u, white.unit, k=2)}")
    if limit is not None:
        out.print(f"  darkest    < {rounded(limit, limit)[0]} cd·m⁻² (limit of detection)")
    else:
        out.print(f"  darkest    {with_u(black.value, 2 * black.u, black.unit, k=2)}")
    for fit in curve.fits().values():
        gamma, off = with_u(fit.parameters["gamma"], 2 * fit.u_gamma, k=2), 100 * fit.rms_rel
        out.print(f"  {fit.model:<16} γ = {gamma}, rms error {off:.2g} %, worst {100 * fit.max_rel:.2g} %")
