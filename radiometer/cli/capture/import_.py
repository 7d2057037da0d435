"""`radiometer import`: what laboratories have (FITS, raw TIFF, EMVA 1288 descriptors, tables) as capture sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes
from radiometer.plausible import Count, Positive


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
    sample: Annotated[Count, typer.Option(help="Keep every n-th row and column.")] = 1,
    full_scale: Annotated[
        Positive | None, typer.Option(help="Full scale of files with 32-bit or floating-point numbers.")
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
    json: JsonOption = False,
) -> None:
    """Turn frames and tables of any laboratory into capture sets.

    Reports what was taken from where, what is missing, what is doubted and what of the files is not used. A number
    without a known unit stops the import; --map settles it. Frames of several cameras, bands or gains of unknown unit
    become a capture set each, in folders of their names.
    """
    with progress(shown=not json) as shown:
        found = rm.import_capture(
            sources, output, crop=parse_patch(crop), sample=sample, full_scale=full_scale, pedestal=pedestal,
            mapped=mapped or (), progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
        return
    for one in found.capture_sets:
        what = f"{one.frames} frames" if one.frames else f"statistics of {one.settings} settings"
        note(f"{one.path}: {what}")
        report = one.record.to_mapping()
        for title in ("mapped", "taken", "missing", "doubts", "not_used", "left_out"):
            for line in report[title]:
                note(f"  {title.replace('_', ' ')}: {line}")
