"""`radiometer log-fit`: finds the term that a camera's log lacks, compared with a reference meter."""

from __future__ import annotations

import typer

import radiometer as rm
from radiometer.cli.analyse.reconcile import show_result
from radiometer.cli.console import console, note
from radiometer.cli.function import command_of


def _show(found: rm.LogFinding) -> None:
    for line in found.taken:
        note(line)
    show_result(found.result)
    out, (readings, nights) = console(), found.size
    out.print(
        f"\n{readings} readings of {nights} nights; error of a night predicted from the others "
        f"{100 * found.fit.error_before:.2f} % → {100 * found.fit.error_after:.2f} %"
    )
    if control := found.fit.control:
        silent = "silent" if control == "agrees" else f"not silent ({control}): do not trust this result"
        out.print(f"negative control (the same search over readings without any missing term): {silent}")


command = command_of("log_fit", _show, reference_file=typer.Option())
