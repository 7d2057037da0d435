"""`radiometer flux`: the radiant flux of a light-emitting diode from a bracket of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import ISO_HELP, parse_measured_iso, parse_patch
from radiometer.cli.console import console, note, show_remarks, show_table
from radiometer.cli.options import JsonOption, relative_option
from radiometer.plausible import HalfAngle, Millimetres, NotNegative, Positive, Uncertainty

if TYPE_CHECKING:
    from radiometer.api.led_flux import FluxReport, Quantity


def command(
    capture: Annotated[Path, typer.Argument(help="Capture set or photographs of the lit diode, several exposures.")],
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file; the capture's camera description where left out.")
    ] = None,
    camera_file: Annotated[
        Path | None, typer.Option(help="Camera file of `radiometer characterise`, instead of a calibration.")
    ] = None,
    patch: Annotated[str | None, typer.Option(help="Region X,Y,W,H that holds the diode and its glow.")] = None,
    half_angle: Annotated[
        HalfAngle | None, typer.Option(help="Degrees at which its intensity is one half (half the viewing angle).")
    ] = None,
    half_angle_u: Annotated[Uncertainty, typer.Option(help="Its standard uncertainty in degrees.")] = 1.0,
    diameter: Annotated[Millimetres | None, typer.Option(help="Diameter of its emitting area in mm.")] = None,
    diameter_u: Annotated[Uncertainty, typer.Option(help="Its standard uncertainty in mm.")] = 0.05,
    distance: Annotated[Millimetres | None, typer.Option(help="Emitter to the lens's entrance pupil in mm.")] = None,
    distance_u: Annotated[Uncertainty, typer.Option(help="Its standard uncertainty in mm.")] = 0.5,
    f_number_u_rel: Annotated[float, relative_option("--f-number-u-rel", "Relative u (k = 1) of the f-number")] = 0.02,
    datasheet_mw: Annotated[Positive | None, typer.Option(help="Flux that the datasheet states, in mW.")] = None,
    channel: Annotated[str, typer.Option(help="Of colour frames: luminance, red, green or blue.")] = "luminance",
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    drive_table: Annotated[
        Path | None, typer.Option(help="CSV of the diode's light over drive, for the flux at another drive.")
    ] = None,
    led: Annotated[str | None, typer.Option(help="Its channel in that table; the only one by default.")] = None,
    drive: Annotated[NotNegative | None, typer.Option(help="Its drive in the capture, in the table's unit.")] = None,
    at_drive: Annotated[NotNegative | None, typer.Option(help="Drive whose flux is asked for.")] = None,
    json: JsonOption = False,
) -> None:
    """Find the radiant flux of a light-emitting diode.

    Gives the flux through the sensor as the sum over unclipped pixels of one photograph, and what it lacks of the
    emitted flux: clipped pixels, background, lens losses, and light that missed the lens.
    """
    found = rm.flux(
        capture, calibration=calibration, camera_file=camera_file, patch=parse_patch(patch) if patch else None,
        half_angle=half_angle, half_angle_u=half_angle_u, diameter=diameter, diameter_u=diameter_u, distance=distance,
        distance_u=distance_u, f_number_u_rel=f_number_u_rel, datasheet_mw=datasheet_mw, channel=channel,
        measured_iso=parse_measured_iso(measured_iso), drive_table=drive_table, led=led, drive=drive, at_drive=at_drive,
    )  # fmt: skip
    for text in found.notes:
        note(text)
    if json:
        print(found.to_json())
        return
    _show(found.report)
    if (other := found.driven) is not None:
        flux = other.flux.scaled(1e3, "mW").text(with_k=True)
        where = "emitted" if found.report.emitted else "through the sensor"
        console().print(f"flux at drive {other.drive:g} of {other.channel}, {where}: {flux}; its law: {other.law}")


def _show(report: FluxReport) -> None:
    out = console()
    rows = [("unclipped pixels of one photograph", _milliwatt(report.thesis), "")]
    rows += [(step.name, _milliwatt(step.flux), f"{100 * step.share:.1f} %") for step in report.corrections]
    if report.reference_w is not None:
        rest = 1.0 - sum(step.share for step in report.corrections)
        rows.append(("datasheet", f"{1e3 * report.reference_w:.4g}", f"open: {100 * rest:.1f} %"))
    show_table("from one photograph to the emitted flux", ("step", "mW (k = 2)", "closes"), rows)
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
    show_remarks(report.assumptions, warnings=report.warnings)


def _milliwatt(quantity: Quantity) -> str:
    return quantity.scaled(1e3, "mW").text(bare=True)
