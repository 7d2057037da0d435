"""`radiometer batch`: one job over all capture sets of an archive."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress
from radiometer.cli.outputs import writes
from radiometer.plausible import AnyCount


@writes()
def command(
    archive: Annotated[str, typer.Argument(help="Folder of capture sets, at any depth, or a glob.")],
    do: Annotated[str, typer.Option(help="merge, response, measure, characterise or reconcile.")] = "measure",
    out: Annotated[Path, typer.Option("-o", "--output", help="Table to write: .parquet or .csv.")] = Path(
        "results.csv"
    ),
    scheduler: Annotated[str | None, typer.Option(help="Dask scheduler that stands already: tcp://HOST:PORT.")] = None,
    workers: Annotated[AnyCount, typer.Option(help="Local worker processes; 0 works in this process.")] = 0,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file; relative values without one.")] = None,
    patch: Annotated[str | None, typer.Option(help="Region X,Y,W,H; each set's own patches by default.")] = None,
    maps: Annotated[Path | None, typer.Option(help="Folder for radiance maps (Zarr), with --do merge.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Summary as JSON on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a table whose journal is missing.")] = False,
) -> int:
    """Do one job on every capture set of an archive and write one table of results.

    What the table holds already of the same captures, settings and code is not done again. A capture set that
    fails becomes a row with its error and does not stop the rest. Ctrl-C leaves a usable table.
    """
    with progress(shown=not json) as shown:
        found = rm.batch(
            archive, do, out, scheduler=scheduler, workers=workers, calibration=calibration, patch=parse_patch(patch),
            maps=maps, force=force, progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
    for path in found.unfinished:
        note(f"left out: {path} holds frames but no capture.yaml (unfinished, or `radiometer import` it first)")
    for row in found.summary.failures:
        note(f"failed: {row['capture']}: {row['error']}")
    note(str(found))
    if found.summary.interrupted:
        note("stopped by the user; run the same words again to go on")
    return int(found.summary.interrupted or bool(found.summary.failures))
