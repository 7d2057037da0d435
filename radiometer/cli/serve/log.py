"""`radiometer log`: query, export and plot the journal."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.console import console, note
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.daemon.journal_reader import JournalReader, ReadingFilter

_SHOWN = 20


@writes("plot")
def command(
    file: Annotated[Path | None, typer.Argument(help="Journal file; the daemon's default one if left out.")] = None,
    journal: Annotated[Path | None, typer.Option(help="Journal file, named as for `radiometer serve`.")] = None,
    since: Annotated[str | None, typer.Option(help="Not before: ISO 8601, or an age such as 15min, 2h, 7d.")] = None,
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

    Without --json, --csv or --plot it prints the newest 20 readings and a summary of all that match.
    """
    if file and journal:
        raise UsageError("name the journal once: as an argument or with --journal")
    if sum((json, csv, events, budget is not None)) > 1:
        raise UsageError("--json, --csv, --events and --budget exclude each other")
    from radiometer.daemon.journal import default_journal_path
    from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
    from radiometer.daemon.timestamps import parse_moment

    reader = JournalReader(file or journal or default_journal_path())
    since_us = parse_moment(since) if since else None
    if events:
        _show_events(reader, since_us, limit or 200)
        return
    if budget is not None:
        _show_budget(reader, budget)
        return
    until_us = parse_moment(until) if until else None
    wanted = ReadingFilter(since_us, until_us, after, flag, clean, limit, newest_first=limit is not None)
    _export(reader, wanted, json=json, csv=csv, plot=plot)


def _export(reader: JournalReader, wanted: ReadingFilter, *, json: bool, csv: bool, plot: Path | None) -> None:
    from radiometer.daemon.journal_reader import to_csv

    lines = reader.lines(wanted)
    if wanted.newest_first:
        lines.reverse()
    if json:
        sys.stdout.writelines(line + "\n" for line in lines)
    elif csv:
        sys.stdout.write(to_csv(lines))
    if plot is not None:
        _draw([json_module.loads(line) for line in lines], plot)
        note(f"{len(lines)} readings drawn into {plot}")
    elif not (json or csv):
        _show([json_module.loads(line) for line in lines])


def _show(readings: list[dict[str, Any]]) -> None:
    from rich.table import Table

    if not readings:
        note("no reading matches")
        return
    table = Table(box=None, pad_edge=False)
    for title in ("number", "time (UTC)", "radiance", "U (95 %)", "unit", "luminance", "flags"):
        table.add_column(title, justify="left" if title in ("time (UTC)", "unit", "flags") else "right")
    for reading in readings[-_SHOWN:]:
        table.add_row(*_cells(reading))
    out = console()
    out.print(table)
    out.print(_summary(readings))


def _cells(reading: dict[str, Any]) -> list[str]:
    radiance, luminance = reading["radiance"], reading["luminance"]
    expanded = None if radiance["u"] is None else radiance["u"] * reading["coverage_factor"]
    return [
        str(reading["sequence"]),
        reading["time"][:23].replace("T", " "),
        _number(radiance["value"]),
        _number(expanded, 2),
        radiance["unit"],
        f"{_number(luminance['value'])} {luminance['unit']}" if luminance else "",
        " ".join(reading["flags"]),
    ]


def _number(value: float | None, digits: int = 5) -> str:
    return "undefined" if value is None else f"{value:.{digits}g}"


def _summary(readings: list[dict[str, Any]]) -> str:
    import statistics

    values = [reading["radiance"]["value"] for reading in readings if reading["radiance"]["value"] is not None]
    span = f"{readings[0]['time'][:19]} to {readings[-1]['time'][:19]}"
    if len(values) < 2:
        return f"{len(readings)} readings, {span}"
    mean, spread = statistics.fmean(values), statistics.stdev(values)
    relative = f" ({100 * spread / abs(mean):.2g} %)" if mean else ""
    return f"{len(readings)} readings, {span}: mean {mean:.6g}, standard deviation {spread:.2g}{relative}"


def _show_events(reader: JournalReader, since_us: int | None, limit: int) -> None:
    out = console()
    for event in reader.events(since_us, limit):
        message = " ".join(event["message"].split())  # one line each, whatever a remark holds
        out.print(f"{event['time'][:23].replace('T', ' ')}  {event['kind']:<11} {message}", markup=False)


def _show_budget(reader: JournalReader, sequence: int) -> None:
    entries = sorted(reader.budget(sequence).items(), key=lambda entry: -entry[1])
    out = console()
    for name, u_rel in entries:
        out.print(f"{name:<32} {100 * u_rel:.3g} %")
    out.print(f"{'combined (k = 1)':<32} {100 * sum(u * u for _, u in entries) ** 0.5:.3g} %")


def _draw(readings: list[dict[str, Any]], target: Path) -> None:
    """Draw the readings with a band of their expanded uncertainty, flagged ones marked."""
    import datetime as dt
    from io import BytesIO

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from radiometer.data.storage import write_bytes_atomic

    defined = [r for r in readings if None not in (r["radiance"]["value"], r["radiance"]["u"])]
    if not defined:
        raise UsageError("there is no reading to draw; widen --since and --until")
    if target.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise UsageError(f"{target}: name a .png, .pdf or .svg file")
    times = [dt.datetime.fromisoformat(r["time"]) for r in defined]
    values = [r["radiance"]["value"] for r in defined]
    spread = [r["radiance"]["u"] * r["coverage_factor"] for r in defined]
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    low, high = ([v + sign * s for v, s in zip(values, spread, strict=True)] for sign in (-1, 1))
    axes.fill_between(times, low, high, alpha=0.22, color="#b4540a", label="expanded uncertainty (k = 2)", linewidth=0)  # type: ignore[arg-type]
    axes.plot(times, values, color="#b4540a", linewidth=1.2, label="radiance")  # type: ignore[arg-type]
    flagged = [(t, v) for t, v, r in zip(times, values, defined, strict=True) if r["flags"]]
    if flagged:
        axes.plot(*zip(*flagged, strict=True), ".", color="#b3261e", label="flagged")
    axes.set_ylabel(f"radiance / {defined[-1]['radiance']['unit']}")
    axes.set_xlabel("time (UTC)")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    content = BytesIO()
    figure.savefig(content, format=target.suffix.lower()[1:], dpi=150)
    write_bytes_atomic(target, content.getvalue())
