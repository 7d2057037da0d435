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
from radiometer.plausible import Limit

if TYPE_CHECKING:
    from radiometer.daemon.log import LoggedReadings

_TIME: Final = "time (UTC)"
_WORDS: Final = ("flags", "place", "place: flags")  # headings of the last column
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
    limit: Annotated[Limit | None, typer.Option(help="At most this many, the newest.")] = None,
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
        most = limit or 200
        shown = rm.log_events(where, since=since, limit=most)
        if len(shown) == most:
            out.print(f"the newest {most} events; --limit N shows more", markup=False)
        for event in shown:
            message = " ".join(event["message"].split())  # one line each, whatever a remark holds
            out.print(f"{event['time'][:23].replace('T', ' ')}  {event['kind']:<11} {message}", markup=False)
        return
    if budget is not None:
        parts = rm.log_budget(budget, where)
        out.print(f"{'contribution':<32} u rel. (k = 1)")
        for name, u_rel in parts.items():
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
    shown = found.readings[-_SHOWN:]
    names = {id(one): place.name for place in found.places for one in place.readings}
    columns = _columns(shown, [names[id(one)] for one in shown])
    table = Table(box=None, pad_edge=False)
    for heading, cells in columns:
        # Places and flags are folded where they do not fit; a number or a date stays whole.
        width = None if heading in _WORDS else max(map(len, [*heading.split("\n"), *cells]))
        table.add_column(heading, justify="left" if heading in (_TIME, *_WORDS) else "right", width=width)
    for row in zip(*(cells for _, cells in columns), strict=True):
        table.add_row(*row)
    out = console()
    out.print(table)
    for place in found.places:
        out.print(place.summary(), markup=False)


def _columns(readings: list[dict[str, Any]], places: list[str]) -> list[tuple[str, list[str]]]:
    """Return headings and cells; a unit and a k that all readings share are in the headings."""
    radiances = [_shown(one["radiance"], one["coverage_factor"], "below_noise" in one["flags"]) for one in readings]
    luminances = [one["luminance"] and " ± ".join(_shown(one["luminance"], one["coverage_factor"])) for one in readings]
    units = [unit_text(one["radiance"]["unit"]) for one in readings]
    factors = [f"{one['coverage_factor']:.3g}" for one in readings]
    unit, k = (cells[0] if len(set(cells)) == 1 else "" for cells in (units, factors))
    flags = [" ".join(one["flags"]) for one in readings]
    named = places if len(set(places)) > 1 else ["" for _ in places]
    words = _WORDS[2 if any(named) and any(flags) else 1 if any(named) else 0]
    columns = {
        "number": [str(one["sequence"]) for one in readings],
        _TIME: [one["time"][:19].replace("T", " ") for one in readings],
        f"radiance\n{unit}".strip(): [value for value, _ in radiances],
        f"U (95 %)\n{f'k = {k}' if k else ''}".strip(): [u for _, u in radiances],
        "k": [] if k else factors,
        "unit": [] if unit else units,
        "luminance\ncd·m⁻²": [text or "" for text in luminances] if any(luminances) else [],
        words: [": ".join(filter(None, texts)) for texts in zip(named, flags, strict=True)],
    }
    return [(heading, cells) for heading, cells in columns.items() if any(cells)]


def _shown(quantity: dict[str, Any], k: float, is_limit: bool = False) -> tuple[str, str]:
    """Return value and expanded uncertainty; below the noise the limit that 95 % is below."""
    value, u = quantity["value"], quantity["u"]
    if value is None or u is None:
        return "undefined" if value is None else f"{value:.5g}", "undefined"
    if is_limit:
        limit = upper_limit(value, u)
        return f"< {rounded(limit, limit)[0]}", "95 %"
    return rounded(value, k * u)
