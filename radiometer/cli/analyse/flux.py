"""`radiometer flux`: the radiant flux of a light-emitting diode from a bracket of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from radiometer.cli.console import console, show_remarks, show_table
from radiometer.cli.function import command_of

if TYPE_CHECKING:
    from radiometer import Flux
    from radiometer.api.led_flux import FluxReport, Quantity


def _show(found: Flux) -> None:
    _show_report(found.report)
    if (other := found.driven) is not None:
        flux = other.flux.scaled(1e3, "mW").text(with_k=True)
        where = "emitted" if found.report.emitted else "through the sensor"
        console().print(f"flux at drive {other.drive:g} of {other.channel}, {where}: {flux}; its law: {other.law}")


def _show_report(report: FluxReport) -> None:
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


command = command_of("flux", _show)
