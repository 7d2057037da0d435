"""`radiometer import`: what laboratories have (FITS, raw TIFF, EMVA 1288 descriptors, tables) as capture sets."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress_bar
from radiometer.cli.outputs import writes

if TYPE_CHECKING:
    from radiometer.importing.sources import WrittenSet


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
    mapped: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            help="Where a fact stands, and its unit: exposure=IMG_EXP:ms, gain=GAIN:0.1dB, or a YAML file of such.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Turn frames and tables of any laboratory into capture sets.

    Reports what was taken from where, what is missing, what is doubted and what of the files is not used. A number
    without a known unit stops the import; --map settles it. Frames of several cameras, bands or gains of unknown unit
    become a capture set each, in folders of their names.
    """
    from radiometer.data.statements import StatementMap
    from radiometer.importing import ImportOptions, import_into

    options = ImportOptions(
        parse_patch(crop) if crop else None, sample, full_scale, pedestal, StatementMap.parse(mapped or ())
    )
    with progress_bar(shown=not json) as bar:
        task = bar.add_task("reading headers", total=None)
        sets = import_into(sources, output, options, lambda done, total: bar.update(task, completed=done, total=total))
    if json:
        print(json_module.dumps({"capture_sets": [_summary(one) for one in sets]}, ensure_ascii=False))
        return
    for one in sets:
        _show(_summary(one))


def _summary(one: WrittenSet) -> dict[str, Any]:
    counted = {"frames": one.frames} if one.frames else {"settings": one.settings}
    return {"path": str(one.path), **counted, **one.record.to_mapping()}


def _show(one: dict[str, Any]) -> None:
    what = f"{one['frames']} frames" if "frames" in one else f"statistics of {one['settings']} settings"
    note(f"{one['path']}: {what}")
    for title in ("mapped", "taken", "missing", "doubts", "not_used", "left_out"):
        for line in one[title]:
            note(f"  {title.replace('_', ' ')}: {line}")
