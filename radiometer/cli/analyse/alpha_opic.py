"""`radiometer alpha-opic`: light of a known spectrum as the five α-opic quantities of CIE S 026."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_relative, parse_size
from radiometer.cli.console import show_remarks, show_table
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes
from radiometer.numbers import unit_text


@writes("plot")
def command(
    value: Annotated[float | None, typer.Argument(min=0.0, help="Value to convert.")] = None,
    unit: Annotated[str, typer.Option(help="Its unit: cd/m2, lx, W/sr/m2 or W/m2.")] = "cd/m2",
    u: Annotated[float, typer.Option("--u", min=0.0, help="Its standard uncertainty in that unit.")] = 0.0,
    reading: Annotated[Path | None, typer.Option(help="File with the JSON of a reading, instead of a value.")] = None,
    screen: Annotated[Path | None, typer.Option(help="Screen calibration, instead of a value.")] = None,
    level: Annotated[float | None, typer.Option(min=0.0, help="Level of the screen.")] = None,
    channel: Annotated[str, typer.Option(help="Channel of the screen.")] = "grey",
    spectrum: Annotated[
        str | None, typer.Option(help="Spectrum of the light by name, or a CSV of wavelength_nm and relative power.")
    ] = None,
    spectrum_u_rel: Annotated[
        float,
        typer.Option(
            "--spectrum-u-rel",
            parser=lambda text: parse_relative(text, "--spectrum-u-rel"),
            metavar="FRACTION",
            help="Relative u (k = 1) of each entry of the spectrum, independent of the others: 0.02 or 2%.",
        ),
    ] = 0.0,
    wavelength_u: Annotated[float, typer.Option(min=0.0, help="u (k = 1) of the spectrum's wavelengths in nm.")] = 0.0,
    size: Annotated[
        str | None,
        typer.Option(metavar="M", help="Size of the source in m, 0.52x0.32 or a disc's diameter: gives irradiance."),
    ] = None,
    distance: Annotated[float | None, typer.Option(min=0.0, help="Distance from the source in m.")] = None,
    distance_u: Annotated[float, typer.Option(min=0.0, help="u (k = 1) of the distance in m.")] = 0.0,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the ratios to daylight into this PNG, PDF or SVG file.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Convert radiance, luminance, irradiance or illuminance into α-opic quantities.

    Gives S-, M-, L-cone-opic, rhodopic and melanopic quantities, and the daylight (D65) that has the same.
    """
    found = rm.alpha_opic(
        value, unit, u=u, reading=reading, screen=screen, level=level, channel=channel, spectrum=spectrum,
        spectrum_u_rel=spectrum_u_rel, wavelength_u_nm=wavelength_u, size_m=parse_size(size), distance_m=distance,
        u_distance_m=distance_u,
    )  # fmt: skip
    if plot is not None:
        found.write_plot(plot)
    if json:
        print(found.to_json())
        return
    first = found.quantities[0]
    head = (
        "α-opic",
        unit_text(first.quantity.unit),
        f"D65, {unit_text(first.equivalent_daylight.unit)}",
        "ratio to D65",
    )
    rows = [
        (
            one.receptor.replace("_", "-"),
            *(each.text(bare=True) for each in (one.quantity, one.equivalent_daylight, one.daylight_ratio)),
        )
        for one in found.quantities
    ]
    show_table(f"{found.source.text()} of {found.spectrum}; k = 2", head, rows)
    show_remarks(found.assumptions)
