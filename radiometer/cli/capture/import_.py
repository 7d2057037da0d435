"""`radiometer import`: what laboratories have (FITS, raw TIFF, EMVA 1288 descriptors, tables) as capture sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress
from radiometer.cli.options import JsonOption


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
    json: JsonOption = False,
) -> None:
    """Turn frames and tables of any laboratory into capture sets.

    Says what was taken from where, what is missing, and what is doubted: a file called 1 s whose header says 60 s, a
    black level tag that the masked rows contradict. Frames of several cameras or bands become a capture set each, in
    folders of their names.
    """
    with progress(shown=not json) as shown:
        found = rm.import_capture(
            sources, output, crop=parse_patch(crop), sample=sample, full_scale=full_scale, pedestal=pedestal,
            progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
        return
    for one in found.capture_sets:
        what = f"{one.frames} frames" if one.frames else f"statistics of {one.settings} settings"
        note(f"{one.path}: {what}")
        report = one.to_mapping()
        for title in ("taken", "missing", "doubts", "left_out"):
            for line in report[title]:
                note(f"  {title.replace('_', ' ')}: {line}")
