"""`radiometer devices`: what can be opened."""

from __future__ import annotations

import radiometer as rm
from radiometer.cli.console import console, note
from radiometer.cli.options import BenchOption, JsonOption


def command(bench: BenchOption = None, json: JsonOption = False) -> None:
    """List the cameras and boxes that can be opened."""
    found = rm.list_devices(bench)
    if json:
        print(found.to_json())
        return
    for line in found.lines():
        console().print(line)
    for port in found.ports_in_use:
        note(f"{port} is held by another program")
    if not found.cameras:
        note("no camera found")
    if found.note:
        note(found.note)
