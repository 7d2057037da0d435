"""`radiometer alpha-opic`: light of a known spectrum as the five α-opic quantities of CIE S 026."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from radiometer.cli.arguments import parse_size
from radiometer.cli.console import show_remarks, show_table
from radiometer.cli.function import command_of
from radiometer.numbers import unit_text

if TYPE_CHECKING:
    from radiometer import AlphaOpicQuantities


def _show(found: AlphaOpicQuantities) -> None:
    first = found.quantities[0]
    units = unit_text(first.quantity.unit), f"D65, {unit_text(first.equivalent_daylight.unit)}"
    rows = [
        (
            one.receptor.replace("_", "-"),
            *(each.text(bare=True) for each in (one.quantity, one.equivalent_daylight, one.daylight_ratio)),
        )
        for one in found.quantities
    ]
    show_table(f"{found.source.text()} of {found.spectrum}; k = 2", ("α-opic", *units, "ratio to D65"), rows)
    show_remarks(found.assumptions)


command = command_of(
    "alpha_opic", _show, results=("plot",), value=typer.Argument(), u=typer.Option("--u"),
    size_m=typer.Option("--size", parser=parse_size, metavar="M"),
    wavelength_u_nm=typer.Option("--wavelength-u"), distance_m=typer.Option("--distance"),
    u_distance_m=typer.Option("--distance-u"),
)  # fmt: skip
