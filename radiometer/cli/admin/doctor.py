"""`radiometer doctor`: what is wrong with this computer and camera, and the cure."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated

import typer

from radiometer.cli.console import console

_MARKS = {
    "ok": "[green]ok     [/]",
    "note": "[cyan]note   [/]",
    "warning": "[yellow]warning[/]",
    "fault": "[red]FAULT  [/]",
}


def command(
    camera: Annotated[
        str | None, typer.Option(help="sim, a GenICam id, serial number or address, or v4l2:, picamera:, gphoto2:.")
    ] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> int:
    """Check the whole chain and print each finding with its cure.

    Looks at the library, USB permissions, network, socket buffers and the daemon; with --camera also at features that
    falsify radiometry, the frame rate achieved, temperature, dark level, and linearity by two exposures. Exit code 1
    if anything keeps one from measuring.
    """
    from rich.markup import escape

    from radiometer.bench.doctor import examine
    from radiometer.daemon.probe import check_daemon
    from radiometer.devices import Health

    findings = [check_daemon(), *examine(bench, camera)]
    sound = not any(finding.health is Health.FAULT for finding in findings)
    if json:
        print(json_module.dumps({"sound": sound, "findings": [finding.to_mapping() for finding in findings]}))
        return 0 if sound else 1
    width = max(len(finding.check) for finding in findings)
    for finding in findings:
        console().print(f"{_MARKS[finding.health]} {finding.check:<{width}}  {escape(finding.message)}")
        if finding.cure:
            console().print(f"{'':<8}{'':<{width}}  → {escape(finding.cure)}")
    if camera is None:
        console().print("the camera itself was not looked at: name one with --camera")
    return 0 if sound else 1
