"""`radiometer devices`: what can be opened."""

from __future__ import annotations

import typer

import radiometer as rm
from radiometer.cli.console import note, show_lines
from radiometer.cli.function import command_of


def _show(found: rm.Devices) -> None:
    show_lines(found)
    for port in found.ports_in_use:
        note(f"{port} is held by another program")
    if not found.cameras:
        note("no camera found")
    if found.note:
        note(found.note)


command = command_of("list_devices", _show, bench=typer.Option())
