"""`radiometer log-fit`: which term a log of a camera beside a reference meter lacks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.console import console, note

if TYPE_CHECKING:
    from radiometer.reconciliation.logs.log_fit import LogFit


def command(
    table: Annotated[
        Path, typer.Argument(help="CSV: the camera's value and exposure, a reference; gain, temperature, time, colour.")
    ],
    beside: Annotated[
        Path | None, typer.Option(help="File of the reference meter with times of its own, where it is not a column.")
    ] = None,
    value: Annotated[str | None, typer.Option(help="Column of the camera's value in DN.")] = None,
    reference: Annotated[str | None, typer.Option(help="Column of the reference.")] = None,
    exposure: Annotated[str | None, typer.Option(help="Column of the exposure time.")] = None,
    gain: Annotated[str | None, typer.Option(help="Column of the gain.")] = None,
    temperature: Annotated[str | None, typer.Option(help="Column of the sensor temperature.")] = None,
    colour: Annotated[str | None, typer.Option(help="Column of the light's colour.")] = None,
    gain_unit: Annotated[
        str | None, typer.Option(help="db, 0.1db, x or iso, where the column's name leaves it open.")
    ] = None,
    black: Annotated[float, typer.Option(help="Black level in DN to take off the value.")] = 0.0,
    no_control: Annotated[bool, typer.Option("--no-control", help="Leave the negative control out.")] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Name the term that a log of a camera under automatic exposure lacks against a reference meter.

    A constant black, a gain whose steps are not what they say, a passband that is not the reference's, temperature,
    dark current, a late shutter, a bent response: whichever predicts nights better from the other nights is named, with
    its size. The same search over values that lack nothing is the negative control.
    """
    from radiometer.importing.log_table import LogColumns, read_log
    from radiometer.reconciliation.logs.log_fit import fit_log

    named = {
        "value": value, "reference": reference, "exposure": exposure, "gain": gain, "temperature": temperature,
        "colour": colour,
    }  # fmt: skip
    chosen = {key: column for key, column in named.items() if column is not None}
    found = fit_log(read_log(table, LogColumns(chosen, gain_unit, black), beside), control=not no_control)
    if json:
        print(found.result.to_json())
        return
    _show(found)


def _show(found: LogFit) -> None:
    from radiometer.cli.analyse.reconcile import show_result

    log = found.state.log
    for line in log.taken:
        note(line)
    show_result(found.result)
    out = console()
    out.print(
        f"\n{log.size} readings of {log.nights} nights; error of a night predicted from the others "
        f"{100 * found.error_before:.2f} % → {100 * found.error_after:.2f} %"
    )
    if found.control:
        silent = "silent" if found.control == "agrees" else f"not silent ({found.control}): trust nothing of this"
        out.print(f"negative control (the same readings made to lack nothing): {silent}")
