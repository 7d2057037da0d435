"""`radiometer log`: query, export and plot the journal."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

import radiometer as rm
from radiometer.cli.console import console, note
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import rounded, unit_text, upper_limit

if TYPE_CHECKING:
    from radiometer.daemon.log import LoggedReadings

_SHOWN: Final = 20  # readings: with the summary they fit a terminal of 24 rows


@writes("plot")
def command(
    file: Annotated[Path | None, typer.Argument(help="Journal file; the daemon's default one if left out.")] = None,
    journal: Annotated[Path | None, typer.Option(help="Journal file, named as for `radiometer serve`.")] = None,
    since: Annotated[
        str | None, typer.Option(help="Not before: ISO 8601 (UTC by default), or an age: 15min, 7d.")
    ] = None,
    until: Annotated[str | None, typer.Option(help="Before this time.")] = None,
    after: Annotated[int | None, typer.Option(help="Only readings with a number above this.")] = None,
    flag: Annotated[str | None, typer.Option(help="Only readings with this flag.")] = None,
    clean: Annotated[bool, typer.Option("--clean", help="Only readings without any flag.")] = False,
    limit: Annotated[int | None, typer.Option(min=1, help="At most this many, the newest.")] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object per reading on standard output.")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="CSV on standard output.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the readings into this PNG, PDF or SVG file.")] = None,
    events: Annotated[bool, typer.Option("--events", help="Show alarms and recoveries instead of readings.")] = False,
    budget: Annotated[
        int | None, typer.Option(help="Show the uncertainty budget of the reading of this number.")
    ] = None,
) -> None:
    """Query, export and plot the daemon's journal, whether the daemon runs or not.

    Without --json, --csv or --plot it prints the newest 20 readings and, for each place that was measured, a summary
    of all that match.
    """
    if file and journal:
        raise UsageError("name the journal once: as an argument or with --journal")
    if sum((json, csv, events, budget is not None)) > 1:
        raise UsageError("--json, --csv, --events and --budget exclude each other")
    where, out = file or journal, console()
    if events:
        for event in rm.log_events(where, since=since, limit=limit or 200):
            message = " ".join(event["message"].split())  # one line each, whatever a remark holds
            out.print(f"{event['time'][:23].replace('T', ' ')}  {event['kind']:<11} {message}", markup=False)
        return
    if budget is not None:
        for name, u_rel in rm.log_budget(budget, where).items():
            out.print(f"{name:<32} {100 * u_rel:.3g} %")
        return
    found = rm.log(where, since=since, until=until, after=after, flag=flag, clean=clean, limit=limit)
    if found.damaged:
        note(f"{found.damaged} rows of the journal are damaged and left out")
    if json:
        sys.stdout.writelines(line + "\n" for line in found.stored)
    elif csv:
        sys.stdout.write(found.to_csv())
    if plot is not None:
        found.write_plot(plot)
        note(f"{len(found.stored)} readings drawn into {plot}")
    elif not (json or csv):
        _show(found)


def _show(found: LoggedReadings) -> None:
    from rich.table import Table

    if not found.stored:
        note("no reading matches")
        return
    table = Table(box=None, pad_edge=False)
    names = {id(one): place.name for place in found.places for one in place.readings}
    several = len(found.places) > 1
    for title in (
        "number",
        "time (UTC)",
        *(["place"] if several else []),
        "radiance",
        "U (95 %)",
        "k",
        "unit",
        "luminance (cd·m⁻²)",
        "flags",
    ):
        table.add_column(title, justify="left" if title in ("time (UTC)", "place", "unit", "flags") else "right")
    for reading in found.readings[-_SHOWN:]:
        table.add_row(*_cells(reading, [names[id(reading)]] if several else []))
    out = console()
    out.print(table)
    for place in found.places:
        out.print(place.summary(), markup=False)


def _cells(reading: dict[str, Any], place: list[str]) -> list[str]:
    radiance, luminance = reading["radiance"], reading["luminance"]
    return [
        str(reading["sequence"]),
        reading["time"][:23].replace("T", " "),
        *place,
        *_shown(radiance, reading["coverage_factor"], "below_noise" in reading["flags"]),
        f"{reading['coverage_factor']:.3g}",
        unit_text(radiance["unit"]),
        " ± ".join(_shown(luminance, reading["coverage_factor"])) if luminance else "",
        " ".join(reading["flags"]),
    ]


def _shown(quantity: dict[str, Any], k: float, is_limit: bool = False) -> tuple[str, str]:
    """Return value and expanded uncertainty; below the noise the limit that 95 % is below."""
    value, u = quantity["value"], quantity["u"]
    if value is None or u is None:
        return "undefined" if value is None else f"{value:.5g}", "undefined"
    if is_limit:
        limit = upper_limit(value, u)
        return f"< {rounded(limit, limit)[0]}", "95 %"
    return rounded(value, k * u)
