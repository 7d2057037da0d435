"""`radiometer characterise`: gain, noise, dark current, saturation and linearity of a camera after EMVA 1288."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import asker, console, note, progress
from radiometer.cli.options import BenchOption, ReportOption, TapsOption, relative_option
from radiometer.cli.outputs import writes
from radiometer.numbers import with_u
from radiometer.plausible import ExposureSteps, KnownRadiance

if TYPE_CHECKING:
    from rich.table import Table


@writes("output", "report", "emva_descriptor", folder="keep")
def command(
    capture: Annotated[
        Path | None, typer.Argument(help="Capture set, or EMVA 1288 descriptor file; or else --camera.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Camera file (YAML) to write.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="Drive this camera: sim, or a GenICam id, serial number or address.")
    ] = None,
    bench: BenchOption = None,
    patch: Annotated[str | None, typer.Option(help="Look at this region X,Y,W,H only.")] = None,
    channel: Annotated[str, typer.Option(help="Of colour cameras: red, green or blue.")] = "green",
    radiance: Annotated[
        KnownRadiance | None,
        typer.Option(help="Known radiance of the region in W/(sr m2), for the quantum efficiency."),
    ] = None,
    radiance_u_rel: Annotated[float, relative_option("--radiance-u-rel", "Its relative u (k = 1)")] = 0.0,
    steps: Annotated[ExposureSteps, typer.Option(help="With --camera: exposures from darkness to saturation.")] = 30,
    keep: Annotated[Path | None, typer.Option(help="With --camera: keep the frames as a capture set here.")] = None,
    report: ReportOption = None,
    emva_descriptor: Annotated[
        Path | None, typer.Option(help="EMVA 1288 descriptor file to write, for other programs.")
    ] = None,
    taps: TapsOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print the camera file as JSON on standard output.")] = False,
) -> None:
    """Find gain, noise, dark current, saturation and linearity of a camera after EMVA 1288.

    Needs pairs of frames of steady, even light over exposure or level, and dark frames; takes them itself from
    --camera. Every figure carries its standard uncertainty.
    """
    with progress(shown=not json) as shown:
        found = rm.characterise(
            capture, parse_patch(patch), channel=channel, camera=camera, bench=bench, radiance=radiance,
            radiance_u_rel=radiance_u_rel, steps=steps, keep=keep,
            emva_descriptor=emva_descriptor, taps=taps, ask=asker(), progress=shown,
        )  # fmt: skip
    for remark in found.remarks:
        note(remark)
    if output:
        found.write(output)
    if report:
        found.write_report(report)
    if json:
        print(found.to_json())
        return
    _show(found)
    for written in (output, report):
        if written:
            note(f"wrote {written}")


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
