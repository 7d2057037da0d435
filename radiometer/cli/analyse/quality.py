"""`radiometer quality`: the instrument's own datasheet, index by index, from captures that it asks for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import asker, console, note, progress
from radiometer.cli.options import BenchOption, CameraOption, JsonOption, PatchOption, command_group, relative_option
from radiometer.cli.outputs import writes
from radiometer.plausible import AnyCount, Count

app = command_group(
    "Measure the instrument's quality indices (ISO/CIE 19476, CIE 244, ISO 9358) and write its datasheet."
)
Session = Annotated[Path, typer.Argument(help="Folder of the session; `take` makes it where it is missing.")]


@app.command("plan")
def plan(json: JsonOption = False) -> None:
    """List the indices, what each asks for, and how it is defined."""
    found, out = rm.quality_plan(), console()
    if json:
        print(found.to_json())
        return
    for one in found.procedures:
        out.print(f"[bold]{one.name}[/bold]  {one.symbol}, {one.title} ({one.source})")
        out.print(f"    {one.definition}")
        for step in one.steps:
            out.print(f"    {step.name}: {step.ask}")
        if one.more:
            out.print(f"    and {one.more}")
        if not one.steps:
            out.print("    no captures: from the camera's spectral response")


@app.command("take")
def take(
    session: Session,
    procedure: Annotated[str, typer.Argument(help="Index to capture for; `radiometer quality plan` lists them.")],
    steps: Annotated[list[str] | None, typer.Argument(help="Steps to take; all that are missing by default.")] = None,
    camera: CameraOption = None,
    bench: BenchOption = None,
    patch: PatchOption = None,
    repeat: Annotated[Count, typer.Option(help="Frames of every exposure.")] = 4,
    darks: Annotated[AnyCount, typer.Option(help="Dark frames per exposure time, where there is a shutter.")] = 2,
) -> None:
    """Take the captures of one index, asking for what each step needs.

    Without a terminal name one STEP at a time and arrange the bench yourself. A step named by a gain, such as 12dB, is
    taken at that gain.
    """
    with progress() as shown:
        written = rm.quality_take(
            session, procedure, steps, camera=camera, bench=bench, patch=parse_patch(patch), repeat=repeat, darks=darks,
            ask=asker(), progress=shown,
        )  # fmt: skip
    for folder in written:
        note(f"{folder}: captured")
    if not written:
        note(f"{session / procedure}: all steps are there; remove a folder to take it again")


@app.command("report")
@writes("out")
def report(
    session: Session,
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file: its corrections are part of the instrument.")
    ] = None,
    patch: PatchOption = None,
    source_u_rel: Annotated[
        float, relative_option("--source-u-rel", "Relative u (k = 1) of the source's steadiness between steps")
    ] = 0.001,
    spectral_response: Annotated[
        Path | None, typer.Option(help="CSV of wavelength in nm and relative responsivity per watt; for f1′.")
    ] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Write the datasheet as HTML.")] = None,
    json: JsonOption = False,
) -> None:
    """Find every index that the captures allow, and write the datasheet; the others are listed as not measured."""
    with progress(shown=not json) as shown:
        found = rm.quality_report(
            session, calibration=calibration, patch=parse_patch(patch),
            source_u_rel=source_u_rel, spectral_response=spectral_response,
            progress=shown,
        )  # fmt: skip
    if out is not None:
        found.write(out)
        note(f"{out}: the datasheet")
    if json:
        print(found.to_json())
        return
    _show(found)


def _show(found: rm.QualityReport) -> None:
    from rich.table import Table

    table = Table(title="quality indices (± at 95.45 %)", title_justify="left")
    for heading in ("index", "of", "value", "±"):
        table.add_column(heading, justify="right" if heading in ("value", "±") else "left")
    for row in found.rows:
        table.add_row(*row)
    console().print(table)
    for one in found.datasheet.indices:
        if one.figure is None:
            note(f"not measured: {one.procedure.called}: {one.reason}")
        for remark in one.figure.remarks if one.figure else ():
            note(f"{one.procedure.symbol}: {remark}")
    for assumption in found.datasheet.assumptions:
        note(f"assumed: {assumption}")
