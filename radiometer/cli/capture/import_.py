"""`radiometer import`: what laboratories have (FITS, raw TIFF, EMVA 1288 descriptors, tables) as capture sets."""

from __future__ import annotations

import typer

import radiometer as rm
from radiometer.cli.console import note
from radiometer.cli.function import command_of


def _show(found: rm.Imported) -> None:
    for one in found.capture_sets:
        what = f"{one.frames} frames" if one.frames else f"statistics of {one.settings} settings"
        note(f"{one.path}: {what}")
        report = one.record.to_mapping()
        for title in ("mapped", "taken", "missing", "doubts", "not_used", "left_out"):
            for line in report[title]:
                note(f"  {title.replace('_', ' ')}: {line}")


command = command_of("import_capture", _show, folder="output", output=typer.Option("-o", "--output"))
