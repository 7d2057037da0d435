"""`radiometer characterise`: gain, noise, dark current, saturation and linearity of a camera after EMVA 1288."""

from __future__ import annotations

import typer

import radiometer as rm
from radiometer.cli.console import console, show_table
from radiometer.cli.function import command_of
from radiometer.numbers import with_u


def _show(found: rm.Sensor) -> None:
    out, result = console(), found.characterisation
    title, head = f"EMVA 1288 figures at {result.gain_db:g} dB", ("symbol", "figure", "value", "U (k = 2)", "unit")
    show_table(title, head, found.rows(), words=(0, 1, 4))
    if found.taps:
        show_table("Taps (± is U, k = 2)", found.TAP_HEADINGS, found.tap_rows(), words=range(len(found.TAP_HEADINGS)))
    for one in found.crosstalk:
        share = with_u(100 * one.share.value, 200 * one.share.u, "%", k=2)
        out.print(f"tap {one.into} reads {share} of the signal of tap {one.of}")
    for remark in result.notes:
        out.print(f"[yellow]note[/yellow]  {remark}")


command = command_of(
    "characterise", _show, files=("emva_descriptor",), folder="keep", results=("output", "report"),
    path=typer.Argument(metavar="CAPTURE"), output=typer.Option("-o", "--output", help="Camera file (YAML) to write."),
)  # fmt: skip
