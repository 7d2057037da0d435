"""`radiometer import`: what laboratories have (FITS, raw TIFF, EMVA 1288 descriptors, tables) as capture sets."""

from __future__ import annotations

import json as json_module
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress_bar
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.data import CaptureHeader
    from radiometer.importing import ImportOptions, ImportRecord
    from radiometer.importing.assembly import Assembled


@writes(folder="output")
def command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            help="FITS or TIFF files, folders or patterns of them, an EMVA 1288 descriptor, or a table of statistics."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture set to write; a new or empty folder.")],
    crop: Annotated[str | None, typer.Option(help="Keep this region X,Y,W,H only.")] = None,
    sample: Annotated[int, typer.Option(min=1, help="Keep every n-th row and column.")] = 1,
    full_scale: Annotated[
        float | None, typer.Option(help="Full scale of files with 32-bit or floating-point numbers.")
    ] = None,
    pedestal: Annotated[
        float, typer.Option(help="Value added to every pixel, where numbers go below zero (processed frames).")
    ] = 0.0,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Turn frames and tables of any laboratory into capture sets.

    Says what was taken from where, what is missing, and what is doubted: a file called 1 s whose header says 60 s, a
    black level tag that the masked rows contradict. Frames of several cameras or bands become a capture set each, in
    folders of their names.
    """
    from radiometer.importing import ImportOptions, statistics_of

    options = ImportOptions(parse_patch(crop) if crop else None, sample, full_scale, pedestal)
    table = statistics_of(sources[0]) if sources[0].exists() else None
    if table is not None and len(sources) > 1:
        raise UsageError("a table of statistics is a source of its own; name it alone")
    sets = _from_table(table, output) if table is not None else _from_files(sources, options, output, shown=not json)
    if json:
        print(json_module.dumps({"capture_sets": sets}, ensure_ascii=False))
        return
    for one in sets:
        _show(one)


def _from_table(header: CaptureHeader, output: Path) -> list[dict[str, Any]]:
    from radiometer.importing.record import record_in
    from radiometer.importing.sources import write_statistics

    write_statistics(header, output)
    return [_summary(output, 0, len(header.statistics), record_in(header))]


def _from_files(sources: list[Path], options: ImportOptions, output: Path, *, shown: bool) -> list[dict[str, Any]]:
    from radiometer.importing import import_sources

    with progress_bar(shown=shown) as bar:
        task = bar.add_task("reading headers", total=None)
        found = import_sources(sources, options, lambda done, total: bar.update(task, completed=done, total=total))
        existed = output.exists()
        try:
            return [
                _copied(one, output if len(found) == 1 else output / one.title, sources[0], options) for one in found
            ]
        except BaseException:
            # Of several cameras all are written or none.
            shutil.rmtree(output, ignore_errors=True)
            if existed:
                output.mkdir(exist_ok=True)
            raise


def _copied(one: Assembled, out: Path, source: Path, options: ImportOptions) -> dict[str, Any]:
    from radiometer.importing import copy_into, imported_of
    from radiometer.importing.sources import as_capture

    written = copy_into(as_capture(one, source, options), out)
    return _summary(out, len(written), 0, imported_of(written))


def _summary(path: Path, frames: int, settings: int, record: ImportRecord) -> dict[str, Any]:
    counted = {"frames": frames} if frames else {"settings": settings}
    return {"path": str(path), **counted, **record.to_mapping()}


def _show(one: dict[str, Any]) -> None:
    what = f"{one['frames']} frames" if "frames" in one else f"statistics of {one['settings']} settings"
    note(f"{one['path']}: {what}")
    for title in ("taken", "missing", "doubts", "left_out"):
        for line in one[title]:
            note(f"  {title.replace('_', ' ')}: {line}")
