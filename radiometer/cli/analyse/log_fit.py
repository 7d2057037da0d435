"""`radiometer log-fit`: finds the term that a camera's log lacks, compared with a reference meter."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.console import console, note
from radiometer.cli.options import JsonOption


def command(
    table: Annotated[
        Path, typer.Argument(help="CSV: the camera's value and exposure, a reference; gain, temperature, time, colour.")
    ],
    reference_file: Annotated[
        Path | None, typer.Option(help="File of the reference meter with separate times, where it is not a column.")
    ] = None,
    mapped: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            help="Column and unit that the table does not state: exposure=t:ms, gain=GAIN:0.1dB, reference=r:mag.",
        ),
    ] = None,
    black: Annotated[float, typer.Option(help="Black level in DN to take off the value.")] = 0.0,
    no_control: Annotated[bool, typer.Option("--no-control", help="Leave the negative control out.")] = False,
    json: JsonOption = False,
) -> None:
    """Name the term that a log of a camera under automatic exposure lacks against a reference meter.

    Candidates are a constant black, wrong gain steps, another passband than the reference's, temperature, dark current,
    a late shutter and a nonlinear response. The candidate that predicts each night best from the other nights is named,
    with its size. The same search over values that lack nothing is the negative control.
    """
    found = rm.log_fit(table, reference_file, mapped=mapped or (), black=black, control=not no_control)
    if json:
        print(found.to_json())
        return
    from radiometer.cli.analyse.reconcile import show_result

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
