"""`radiometer flux`: the radiant flux of a light-emitting diode from a bracket of it."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import console
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.analysis.flux.report import Emitter, FluxReport
    from radiometer.data import Quantity


def command(
    capture: Annotated[Path, typer.Argument(help="Capture set of the lit diode, several exposures.")],
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file; the capture's camera description where left out.")
    ] = None,
    camera_file: Annotated[
        Path | None, typer.Option(help="Camera file of `radiometer characterise`, instead of a calibration.")
    ] = None,
    patch: Annotated[str | None, typer.Option(help="Region X,Y,W,H that holds the diode and its glow.")] = None,
    half_angle: Annotated[
        float | None, typer.Option(help="Angle in degrees at which its intensity is one half (half the viewing angle).")
    ] = None,
    half_angle_u: Annotated[float, typer.Option(min=0.0, help="Its standard uncertainty in degrees.")] = 1.0,
    diameter: Annotated[float | None, typer.Option(help="Diameter of its emitting area in mm.")] = None,
    diameter_u: Annotated[float, typer.Option(min=0.0, help="Its standard uncertainty in mm.")] = 0.05,
    distance: Annotated[float | None, typer.Option(help="From emitter to the lens's entrance pupil in mm.")] = None,
    distance_u: Annotated[float, typer.Option(min=0.0, help="Its standard uncertainty in mm.")] = 0.5,
    f_number_u_rel: Annotated[
        float, typer.Option(min=0.0, help="Relative standard uncertainty of the f-number.")
    ] = 0.02,
    datasheet_mw: Annotated[float | None, typer.Option(help="Flux that the datasheet states, in mW.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON on standard output.")] = False,
) -> None:
    """Find the radiant flux of a light-emitting diode.

    Gives the flux through the sensor as the sum over unclipped pixels of one photograph, and what it lacks of the
    emitted flux: clipped pixels, background, lens losses, and light that missed the lens.
    """
    from radiometer.analysis.flux.estimate import led_flux
    from radiometer.analysis.flux.sensor import flux_scale
    from radiometer.cli.direct import opened
    from radiometer.data import Calibration
    from radiometer.devices import CameraPreset

    region = parse_patch(patch) if patch else None
    emitter = _emitter(half_angle, half_angle_u, diameter, diameter_u, distance, distance_u, datasheet_mw)
    taken = opened(capture)
    if calibration and camera_file:
        raise UsageError("--calibration and --camera-file exclude each other")
    known = Calibration.read(calibration) if calibration else None
    camera, u_rel = taken.header.camera, None
    if camera_file:
        preset = CameraPreset.read(camera_file)
        camera, u_rel = preset.applied_to(camera, str(camera_file)), preset.figure_u_rel("R")
    scale = flux_scale(camera, taken.header.source, known, u_rel)
    report = led_flux(list(taken.frames()), scale, taken.header.lens, emitter, region, f_number_u_rel)
    if json:
        print(json_module.dumps(report.to_mapping(), ensure_ascii=False, allow_nan=False))
    else:
        _show(report)


def _emitter(
    half_angle: float | None,
    half_angle_u: float,
    diameter: float | None,
    diameter_u: float,
    distance: float | None,
    distance_u: float,
    datasheet_mw: float | None,
) -> Emitter | None:
    from radiometer.analysis.flux.report import Emitter
    from radiometer.data import Quantity

    if half_angle is None:
        if any(v is not None for v in (diameter, distance, datasheet_mw)):
            raise UsageError(
                "the emitted flux needs --half-angle, the datasheet's angle of half intensity in degrees (half of the "
                "viewing angle; 60 for an emitter without a lens)"
            )
        return None
    for name, value in (("--diameter", diameter), ("--distance", distance), ("--datasheet-mw", datasheet_mw)):
        if value is not None and not value > 0:
            raise UsageError(f"{name} {value:g}: must be above 0")
    return Emitter(
        Quantity(half_angle, half_angle_u, "°"),
        None if diameter is None else Quantity(diameter, diameter_u, "mm"),
        None if distance is None else Quantity(distance, distance_u, "mm"),
        None if datasheet_mw is None else datasheet_mw * 1e-3,
    )


def _show(report: FluxReport) -> None:
    from rich.table import Table

    out = console()
    table = Table(title="from one photograph to the emitted flux", title_justify="left")
    table.add_column("step", no_wrap=True)
    table.add_column("mW (k = 2)", justify="right", no_wrap=True)
    table.add_column("closes", justify="right")
    table.add_row("unclipped pixels of one photograph", _milliwatt(report.thesis), "")
    for step in report.corrections:
        table.add_row(step.name, _milliwatt(step.flux), f"{100 * step.share:.1f} %")
    if report.reference_w is not None:
        rest = 1.0 - sum(step.share for step in report.corrections)
        table.add_row("datasheet", f"{1e3 * report.reference_w:.4g}", f"open: {100 * rest:.1f} %")
    out.print(table)
    left_out = f"{100 * report.thesis_left_out:.2g} % of its pixels are at 0 or full scale and left out"
    out.print(f"the photograph: {report.thesis_exposure_s:g} s, {left_out}")
    for step in report.corrections:
        out.print(f"{step.name}: {step.note}")
    for name, flux in report.emitted.items():
        out.print(f"emitted flux, {name.replace('_', ' ')}: [bold]{_milliwatt(flux)} mW[/bold]")
    if not report.emitted:
        out.print(f"flux through the sensor: [bold]{_milliwatt(report.on_sensor)} mW[/bold]")
        out.print("for the emitted flux give --half-angle, and --distance (or --diameter of a sharp picture)")
    if report.clipped_everywhere:
        out.print(
            f"[yellow]flag saturated[/yellow]: {report.clipped_everywhere} pixels clip even in the shortest exposure: "
            "every flux here is a lower bound; take shorter exposures, a smaller aperture or a grey filter"
        )
    for assumption in report.assumptions:
        out.print(f"assumed: {assumption}")


def _milliwatt(quantity: Quantity) -> str:
    from radiometer.cli.console import significant

    return f"{significant(1e3 * quantity.value, 2e3 * quantity.u)} ± {2e3 * quantity.u:.2g}"
