"""`radiometer batch`: one job over all capture sets of an archive."""

from __future__ import annotations

import json as json_module
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress_bar
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError


@writes()
def command(
    archive: Annotated[str, typer.Argument(help="Folder of capture sets, at any depth, or a glob.")],
    do: Annotated[str, typer.Option(help="merge, response, measure, characterise or reconcile.")] = "measure",
    out: Annotated[Path, typer.Option("-o", "--output", help="Table to write: .parquet or .csv.")] = Path(
        "results.csv"
    ),
    scheduler: Annotated[str | None, typer.Option(help="Dask scheduler that stands already: tcp://HOST:PORT.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Local worker processes; 0 works in this process.")] = 0,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file; relative values without one.")] = None,
    patch: Annotated[
        str | None, typer.Option(help="Region X,Y,W,H; each capture set's own patches by default.")
    ] = None,
    maps: Annotated[Path | None, typer.Option(help="Folder for radiance maps (Zarr), with --do merge.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Summary as JSON on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a table whose journal is missing.")] = False,
) -> int:
    """Do one job on every capture set of an archive and write one table of results.

    What the table holds already of the same captures, settings and code is not done again. A capture set that
    fails becomes a row with its error and does not stop the rest. Ctrl-C leaves a usable table.
    """
    from radiometer.api.outputs import check_outputs
    from radiometer.archive.discovery import find_captures
    from radiometer.archive.jobs import JOBS
    from radiometer.archive.journal import journal_of
    from radiometer.archive.run import run_batch
    from radiometer.archive.settings import JobSettings

    if do not in JOBS:
        raise UsageError(f"--do {do!r}: there is no such job; there are {', '.join(JOBS)}")
    check_outputs(out, force=force or journal_of(out).exists())
    region = parse_patch(patch) if patch else None
    captures, unfinished = find_captures(archive)
    settings = JobSettings(
        do,
        calibration=str(calibration) if calibration else None,
        patch=(region.x, region.y, region.width, region.height) if region else None,
        maps=str(maps.resolve()) if maps else None,
    )
    with progress_bar() as bar:
        task = bar.add_task(do, total=len(captures))
        summary = run_batch(
            captures, settings, out, scheduler=scheduler, workers=workers, progress=lambda *_: bar.advance(task)
        )
    if json:
        print(json_module.dumps({**asdict(summary), "table": str(out), "unfinished": [str(p) for p in unfinished]}))
    for path in unfinished:
        note(f"left out: {path} holds frames but no capture.yaml (an unfinished capture)")
    for row in summary.failures:
        note(f"failed: {row['capture']}: {row['error']}")
    note(f"{out}: {summary.rows_in_table} rows; {summary.done} done, {summary.skipped} as before")
    if summary.interrupted:
        note("stopped by the user; run the same words again to go on")
    return int(summary.interrupted or bool(summary.failures))
