"""`radiometer doctor`: what is wrong with this computer and camera, and the cure."""

from __future__ import annotations

import radiometer as rm
from radiometer.cli.console import console
from radiometer.cli.options import BenchOption, CameraOption, JsonOption

_MARKS = {
    "ok": "[green]ok     [/]",
    "note": "[cyan]note   [/]",
    "warning": "[yellow]warning[/]",
    "fault": "[red]FAULT  [/]",
}


def command(camera: CameraOption = None, bench: BenchOption = None, json: JsonOption = False) -> int:
    """Check the whole chain and print each finding with its cure.

    Looks at the library, USB permissions, network, socket buffers and the daemon; with --camera also at features that
    falsify radiometry, the frame rate achieved, temperature, dark level, and linearity by two exposures. Exit code 1
    if anything keeps one from measuring.
    """
    from rich.markup import escape

    found = rm.doctor(camera, bench)
    if json:
        print(found.to_json())
        return 0 if found.sound else 1
    width = max(len(finding.check) for finding in found.findings)
    for finding in found.findings:
        console().print(f"{_MARKS[finding.health]} {finding.check:<{width}}  {escape(finding.message)}")
        if finding.cure:
            console().print(f"{'':<8}{'':<{width}}  → {escape(finding.cure)}")
    if camera is None:
        console().print("the camera itself was not looked at: name one with --camera")
    return 0 if found.sound else 1
