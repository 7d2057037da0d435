"""`radiometer characterise`: gain, noise, dark current, saturation and linearity of a camera after EMVA 1288."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

import radiometer as rm
from radiometer.cli.console import console
from radiometer.cli.function import command_of
from radiometer.numbers import with_u

if TYPE_CHECKING:
    from rich.table import Table


def _of_taps(found: rm.Sensor) -> Table:
    from rich.table import Table

    table = Table(title="Taps (± is U, k = 2)", title_justify="left")
    for heading in found.TAP_HEADINGS:
        table.add_column(heading)
    for row in found.tap_rows():
        table.add_row(*row)
    return table


def _show(found: rm.Sensor) -> None:
    from rich.table import Table

    out, result = console(), found.characterisation
    table = Table(title=f"EMVA 1288 figures at {result.gain_db:g} dB", title_justify="left")
    for heading in ("symbol", "figure", "value", "U (k = 2)", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "U (k = 2)") else "left")
    for row in found.rows():
        table.add_row(*row)
    out.print(table)
    if found.taps:
        out.print(_of_taps(found))
    for one in found.crosstalk:
        share = with_u(100 * one.share.value, 200 * one.share.u, "%", k=2)
        out.print(f"tap {one.into} reads {share} of the signal of tap {one.of}")
    for remark in result.notes:
        out.print(f"[yellow]note[/yellow]  {remark}")


command = command_of(
    "characterise", _show, files=("emva_descriptor",), folder="keep", results=("output", "report"),
    path=typer.Argument(metavar="CAPTURE"), output=typer.Option("-o", "--output", help="Camera file (YAML) to write."),
)  # fmt: skip
