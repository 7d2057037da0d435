"""`radiometer quality`: the instrument's own datasheet, index by index, from captures that it asks for."""

from __future__ import annotations

from pathlib import Path

import typer

import radiometer as rm
from radiometer.cli.console import console, note, show_table
from radiometer.cli.function import command_of
from radiometer.cli.options import command_group

app = command_group(
    "Measure the instrument's quality indices (ISO/CIE 19476, CIE 244, ISO 9358) and write its datasheet."
)
_DATASHEET = typer.Option("--out", "-o", help="Write the datasheet as HTML.")


def _show_plan(found: rm.QualityPlan) -> None:
    out = console()
    for one in found.procedures:
        out.print(f"[bold]{one.name}[/bold]  {one.symbol}, {one.title} ({one.source})")
        out.print(f"    {one.definition}")
        for step in one.steps:
            out.print(f"    {step.name}: {step.ask}")
        if one.more:
            out.print(f"    and {one.more}")
        if not one.steps:
            out.print("    no captures: from the camera's spectral response")


def _show_taken(written: list[Path]) -> None:
    for folder in written:
        note(f"{folder}: captured")
    if not written:
        note("all steps are there; remove a folder to take it again")


def _show(found: rm.QualityReport) -> None:
    show_table("quality indices (± at 95.45 %)", ("index", "of", "value", "±"), found.rows, words=(0, 1))
    for one in found.datasheet.indices:
        if one.figure is None:
            note(f"not measured: {one.procedure.called}: {one.reason}")
        for remark in one.figure.remarks if one.figure else ():
            note(f"{one.procedure.symbol}: {remark}")
    for assumption in found.datasheet.assumptions:
        note(f"assumed: {assumption}")


app.command("plan")(command_of("quality_plan", _show_plan))
app.command("take")(command_of("quality_take", _show_taken, json=False, steps=typer.Argument()))
app.command("report")(
    command_of("quality_report", _show, results=("out",), defaults={"source_u_rel": 0.001}, out=_DATASHEET)
)
