"""`radiometer devices`: what can be opened."""

from __future__ import annotations

import dataclasses
import json as json_module
from pathlib import Path
from typing import Annotated

import typer

from radiometer.cli.console import console, note


def command(
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """List the cameras and boxes that can be opened."""
    from radiometer.bench.boxes import find_boxes
    from radiometer.bench.cameras import OWN_KINDS, SIMULATED, list_cameras
    from radiometer.bench.config import read_bench
    from radiometer.data.serials import other_notation, serial_shown

    config, where = read_bench(bench)
    cameras, missing = list_cameras(config, where)
    boxes, held = find_boxes()
    if json:
        found = {
            "cameras": [
                {**dataclasses.asdict(entry), "serial_also": other_notation(entry.serial)} for entry in cameras
            ],
            "light_boxes": [dataclasses.asdict(entry) for entry in boxes],
            "ports_in_use": held,
            "note": missing,
        }
        print(json_module.dumps(found))
        return
    for entry in cameras:
        name = SIMULATED if entry.interface == "simulated" else entry.serial or entry.device_id
        if entry.device_id.partition(":")[0] in OWN_KINDS:
            name = entry.device_id
        serial = f"  serial {serial_shown(entry.serial)}" if entry.serial else ""
        console().print(f"{entry.vendor} {entry.model}{serial}  {entry.interface}  --camera {name}".strip())
    for box in boxes:
        console().print(f"light box  serial {box.serial}  firmware {box.firmware}  {box.port}  --box {box.serial}")
    for port in held:
        note(f"{port} is held by another program")
    if not cameras:
        note("no camera found")
    if missing:
        note(missing)
