"""`radiometer screen`: calibrate a screen, look up levels, export to other programs."""

from __future__ import annotations

import json as json_module
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.calibrate.screen_import import register
from radiometer.cli.console import console, note, progress_bar, significant
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.bench.screen import ScreenBench
    from radiometer.screen import ChannelCurve, ScreenCalibration
    from radiometer.screen.calibration_run import Options

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    help="Calibrate a screen as a light source, and use the calibration.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
@writes("out")
def calibrate(
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write.")] = Path("screen.yaml"),
    display: Annotated[str, typer.Option(help="browser, or a simulated one: lcd, pwm_lcd, oled.")] = "browser",
    name: Annotated[str | None, typer.Option(help="What the screen is called; the display's name by default.")] = None,
    levels: Annotated[str, typer.Option(help="all, quick, a count such as 33, or a list such as 0,16,255.")] = "33",
    quick: Annotated[bool, typer.Option("--quick", help="Darkest, brightest and five levels between.")] = False,
    channels: Annotated[str, typer.Option(help="Channels: grey,red,green,blue or some of them.")] = "grey",
    repeats: Annotated[int, typer.Option(min=1, help="Readings of every patch.")] = 1,
    size: Annotated[float, typer.Option(min=0.01, max=1.0, help="Patch size as a share of the screen's.")] = 1.0,
    pixel_mm: Annotated[
        float | None, typer.Option(min=0.01, max=5.0, help="Distance of two pixels in mm, for `adapt run`.")
    ] = None,
    warm_up: Annotated[float, typer.Option(min=0.0, help="Longest wait for the screen to settle in s.")] = 900.0,
    white: Annotated[str, typer.Option(help="Spectrum assumed for grey: white_led, cie_d65, a CSV …")] = "white_led",
    primaries: Annotated[
        str | None, typer.Option(help="Spectra of red, green, blue: led_lcd, ccfl_lcd, oled, crt, or a CSV of them.")
    ] = None,
    camera: Annotated[str | None, typer.Option(help="GenICam id, serial number or address.")] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="The camera's calibration; the bench's by default.")] = None,
    patch: Annotated[str | None, typer.Option(help="Where the camera sees the patch: X,Y,W,H in pixels.")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 for any free one.")] = 0,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in this machine's browser.")] = False,
    export: Annotated[str, typer.Option(help="Also write: psychopy,ti3,csv,inverse,vcgt,cal.")] = "",
    argyll: Annotated[bool, typer.Option("--argyll", help="Print spotread's line for every level measured.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random order.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Report as one JSON object on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Measure which level of a screen gives which radiance and luminance, with uncertainty."""
    from radiometer.api.outputs import check_outputs
    from radiometer.bench.screen import lights, open_screen_bench, primaries_of
    from radiometer.screen.calibration_run import Options, calibrate_screen
    from radiometer.screen.plan import parse_levels

    options = Options(
        name=name or display,
        levels=parse_levels("quick" if quick else levels),
        channels=tuple(part.strip() for part in channels.split(",") if part.strip()),
        repeats=repeats,
        patch_size=size,
        warm_up_limit_s=warm_up,
        seed=seed,
        pixel_mm=pixel_mm,
    )
    kinds = _export_kinds(export)
    check_outputs(*_export_files(kinds, out), force=force)
    where = parse_patch(patch) if patch else None
    lamps = lights(white, primaries_of(display, options.channels, primaries))

    def announce(url: str) -> None:
        note(f"open this address on the screen to be measured, then press Start:\n  {url}")
        if open_browser:
            webbrowser.open(url)

    with (
        open_screen_bench(
            display, bench=bench, camera=camera, calibration=calibration, patch=where, port=port, announce=announce
        ) as opened,
        progress_bar(shown=not json) as bar,
    ):
        task = bar.add_task("measuring the screen", total=None)
        result = calibrate_screen(
            opened, options, lamps, progress=lambda done, total, _step: bar.update(task, completed=done, total=total)
        )
        for warning in _page_warnings(opened):
            note(f"warning: {warning}")
    result.write(out)
    _write_exports(result, kinds, out)
    _report(result, out, argyll=argyll, json=json, options=options)


register(app)


@app.command()
def level(
    calibration: Annotated[Path, typer.Argument(help="Screen calibration file.")],
    target: Annotated[float, typer.Argument(help="Wanted value.")],
    unit: Annotated[str, typer.Option(help="cd, scotopic or W (per sr and m2).")] = "cd",
    channel: Annotated[str, typer.Option(help="grey, red, green or blue.")] = "grey",
    json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Say which level shows a wanted luminance or radiance."""
    from radiometer.screen.calibration import LUMINANCE, RADIANCE, SCOTOPIC, ScreenCalibration

    units = {"cd": LUMINANCE, "scotopic": SCOTOPIC, "W": RADIANCE}
    if unit not in units:
        raise UsageError(f"--unit {unit!r}: choose {', '.join(units)}")
    curve = ScreenCalibration.read(calibration).channel(channel)
    found = curve.level_for(target, units[unit])
    shown = curve.at(found, units[unit])
    if json:
        print(json_module.dumps({"channel": channel, "level": found, "shown": shown.to_mapping(), "target": target}))
    else:
        value = f"{significant(shown.value, shown.u)} ± {2 * shown.u:.2g} {shown.unit}"
        console().print(f"level {found} of {channel} shows {value} (k = 2)")


@app.command("export")
@writes()
def export_command(
    calibration: Annotated[Path, typer.Argument(help="Screen calibration file.")],
    kinds: Annotated[str, typer.Argument(help="psychopy,ti3,csv,inverse,vcgt,cal or some of them.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder; beside the calibration by default.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Write a calibration in the forms of other programs."""
    from radiometer.api.outputs import check_outputs
    from radiometer.screen import ScreenCalibration

    chosen = _export_kinds(kinds)
    if not chosen:
        raise UsageError("name at least one form: psychopy,ti3,csv,inverse,vcgt,cal")
    base = (out or calibration.parent) / calibration.name
    check_outputs(*_export_files(chosen, base), force=force)
    for written in _write_exports(ScreenCalibration.read(calibration), chosen, base):
        console().print(f"wrote {written}")


def _export_kinds(text: str) -> list[str]:
    from radiometer.screen.exports import EXPORTS

    kinds = [part.strip() for part in text.split(",") if part.strip()]
    for kind in kinds:
        if kind not in EXPORTS:
            raise UsageError(f"export {kind!r} is unknown; choose from {', '.join(EXPORTS)}")
    return kinds


def _write_exports(calibration: ScreenCalibration, kinds: list[str], beside: Path) -> list[Path]:
    from radiometer.screen.exports import write_export

    files = _export_files(kinds, beside)
    for kind, path in zip(kinds, files, strict=True):
        write_export(calibration, kind, path)
    return files


def _export_files(kinds: list[str], base: Path) -> list[Path]:
    from radiometer.screen.exports import EXPORTS

    return [base.with_suffix(EXPORTS[kind][1]) for kind in kinds]


def _page_warnings(opened: ScreenBench) -> list[str]:
    ask = getattr(opened.display, "warnings", None)
    return list(ask()) if ask else []


def _report(calibration: ScreenCalibration, out: Path, *, argyll: bool, json: bool, options: Options) -> None:
    if json:
        print(json_module.dumps({"file": str(out), **calibration.to_mapping()}, allow_nan=False))
        return
    if argyll:
        _print_argyll(calibration)
    for curve in calibration.channels.values():
        _print_channel(curve)
    _print_checks(calibration.checks)
    for assumption in calibration.provenance.assumptions:
        console().print(f"assumed    {assumption}")
    console().print(f"wrote {out}")


def _print_argyll(calibration: ScreenCalibration) -> None:
    from radiometer.screen.calibration import LUMINANCE
    from radiometer.screen.exports.chromaticity import argyll_line

    for name, curve in calibration.channels.items():
        for n in curve.levels:
            print(argyll_line(name, curve.at(n, LUMINANCE).value))


def _print_channel(curve: ChannelCurve) -> None:
    from radiometer.screen.calibration import LUMINANCE

    out = console()
    white, black = (curve.at(curve.levels[i], LUMINANCE) for i in (-1, 0))
    out.print(f"[bold]{curve.name}[/bold]: {len(curve.levels)} levels")
    out.print(f"  brightest  {significant(white.value, white.u)} ± {2 * white.u:.2g} cd·m⁻² (k = 2)")
    if curve.radiance_is_lost(curve.levels[0]):
        out.print(
            f"  darkest    below {curve.detection_limit * curve.efficacy(LUMINANCE):.2g} cd·m⁻² (limit of detection)"
        )
    else:
        out.print(f"  darkest    {significant(black.value, black.u)} ± {2 * black.u:.2g} cd·m⁻² (k = 2)")
    for fit in curve.fits().values():
        shown = ", ".join(f"{k} {v:.4g}" for k, v in fit.parameters.items())
        out.print(f"  {fit.model:<16} rms error {100 * fit.rms_rel:.2g} %, worst {100 * fit.max_rel:.2g} %   ({shown})")


def _print_checks(checks: dict[str, Any]) -> None:
    out = console()
    warm, flicker = checks["warm_up"], checks["flicker"]
    state = "steady" if warm["steady"] else "still drifting"
    out.print(
        f"warm-up    {state} after {warm['waited_s']:.0f} s; "
        f"drift while measuring {100 * checks['drift_rel']:.2g} % (taken out)"
    )
    if flicker["found"]:
        out.print(
            f"[yellow]flicker    light changes by {100 * flicker['scatter_rel']:.2g} % between frames of "
            f"{1e3 * flicker['exposure_s']:.3g} ms (PWM dimming?): {checks['repeats']} readings are averaged[/yellow]"
        )
    grid = checks.get("uniformity")
    if grid:
        out.print(f"uniformity {100 * grid['lowest']:.1f} to {100 * grid['highest']:.1f} % of the middle")
    if checks.get("additivity_rel") is not None:
        out.print(f"additivity primaries add up to white within {100 * checks['additivity_rel']:.2g} %")
