"""`radiometer doctor`: what is wrong with this computer and camera, and the cure."""

from __future__ import annotations

import typer

import radiometer as rm
from radiometer.cli.console import console
from radiometer.cli.function import command_of

_MARKS = {
    "ok": "[green]ok     [/]",
    "note": "[cyan]note   [/]",
    "warning": "[yellow]warning[/]",
    "fault": "[red]FAULT  [/]",
}


def _show(found: rm.Diagnosis) -> None:
    from rich.markup import escape

    width = max(len(finding.check) for finding in found.findings)
    for finding in found.findings:
        console().print(f"{_MARKS[finding.health]} {finding.check:<{width}}  {escape(finding.message)}")
        if finding.cure:
            console().print(f"{'':<8}{'':<{width}}  → {escape(finding.cure)}")


command = command_of(
    "doctor", _show, camera=typer.Option(), bench=typer.Option(), code=lambda found: int(not found.sound)
)
