"""`radiometer measure`: the radiance of a patch, with its uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

import radiometer as rm
from radiometer.cli.arguments import ISO_HELP, UNSTATED_ISO_HELP, parse_measured_iso, parse_patch
from radiometer.cli.console import asker, console, note, progress
from radiometer.cli.options import BenchOption, CameraOption, FNumberOption, PatchOption, UncalibratedOption, URelOption
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import below, rounded, upper_limit, with_u
from radiometer.plausible import Limit, Period
from radiometer.reporting.reading_page import FLAG_MEANINGS

if TYPE_CHECKING:
    from radiometer import Reading


@writes("report")
def command(
    camera: CameraOption = None,
    patch: PatchOption = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file; the bench's by default.")] = None,
    uncalibrated: UncalibratedOption = False,
    bench: BenchOption = None,
    photographs: Annotated[Path | None, typer.Option(help="Folder of photographs to read instead of a camera.")] = None,
    channel: Annotated[str, typer.Option(help="Of colour frames: luminance, red, green or blue.")] = "luminance",
    align: Annotated[
        str, typer.Option(help="Photographs from the hand: auto (where they moved), on, or off.", metavar="auto|on|off")
    ] = "auto",
    linear: Annotated[
        bool, typer.Option("--linear", help="Uncalibrated photographs are linear above black (raw files always are).")
    ] = False,
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    iso: Annotated[float | None, typer.Option(help=UNSTATED_ISO_HELP)] = None,
    pattern: Annotated[str | None, typer.Option(help="Pattern of a capture set that holds several.")] = None,
    f_number: FNumberOption = None,
    spectrum: Annotated[str | None, typer.Option(help="Spectrum assumed for the luminance.")] = None,
    u_rel: URelOption = None,
    repeat: Annotated[Limit, typer.Option(help="Number of readings.")] = 1,
    watch: Annotated[
        bool, typer.Option("--watch", help="Read until stopped by Ctrl-C; a camera that is lost is waited for.")
    ] = False,
    every: Annotated[Period, typer.Option(help="Seconds from one reading's start to the next's.")] = 0.0,
    darks: Annotated[
        bool, typer.Option("--darks", help="Ask for the lens to be covered, and take dark frames with every reading.")
    ] = False,
    monte_carlo: Annotated[
        bool, typer.Option("--monte-carlo", help="Print the interval by the propagation of distributions as well.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="Page of the reading to write: .html or .pdf, with picture and budget.")
    ] = None,
    budget: Annotated[bool, typer.Option("--budget", help="Print the uncertainty budget.")] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON object per reading on standard output.")] = False,
) -> None:
    """Read the radiance of a patch, with its uncertainty.

    Meters the patch, takes the necessary exposures and merges them. Prints the radiance in W·sr⁻¹·m⁻² with its expanded
    uncertainty (95.45 %, k by Student's t), the luminance, and the flags of the reading.
    """
    if report is not None and (watch or repeat > 1):
        raise UsageError("--report writes the page of one reading: leave --watch and --repeat out")
    if calibration and uncalibrated:
        raise UsageError("--calibration and --uncalibrated exclude each other")
    parsed = parse_patch(patch) if patch else None
    if photographs is not None or measured_iso or linear or iso is not None or pattern is not None:
        if photographs is None or camera or bench:
            raise UsageError(
                "--photographs replaces --camera and --bench; --measured-iso, --iso, --pattern and --linear "
                "belong to it"
            )
        with progress(shown=not json) as shown:
            reading = rm.measure_photographs(
                photographs, parsed, calibration=calibration, uncalibrated=uncalibrated, channel=channel,
                pattern=pattern, align=align, linear=linear, measured_iso=parse_measured_iso(measured_iso), iso=iso,
                f_number=f_number, spectrum=spectrum, monte_carlo=monte_carlo, report=report, progress=shown,
            )  # fmt: skip
        for text in reading.more["notes"]:
            note(text)
        if json:
            print(reading.to_json(), flush=True)
        else:
            if reading.more["alignment"]:
                note(f"frames: {reading.more['alignment']}")
            for assumption in reading.more["assumptions"]:
                note(f"assumed: {assumption}")
            _show(reading, budget=budget)
        _note_page(report)
        return
    with progress(shown=not json) as shown:
        for reading in rm.readings(
            camera, parsed, bench=bench, calibration=calibration, uncalibrated=uncalibrated, f_number=f_number,
            spectrum=spectrum, u_rel=u_rel, darks=darks, monte_carlo=monte_carlo, report=report, repeat=repeat,
            watch=watch, every_s=every, ask=asker(), notice=_silent if json and not watch else note, progress=shown,
        ):  # fmt: skip
            if json:
                print(reading.to_json(), flush=True)
            else:
                _show(reading, budget=budget)
    _note_page(report)


def _note_page(report: Path | None) -> None:
    """Print where the page of a reading was written."""
    if report is not None:
        note(f"report: {report}")


def _silent(line: str) -> None:
    """Drop a notice: JSON goes to programs, which find it in the reading."""


def _show_distribution(reading: Reading) -> None:
    """Print the interval by the propagation of distributions next to the budget's."""
    drawn = reading.more["monte_carlo"]
    out, u = console(), reading.radiance.u
    low, high = (rounded(drawn[end], 2 * u)[0] for end in ("low", "high"))
    out.print(f"drawn      {low} to {high} (95.45 %, JCGM 101), u = {drawn['u']:.3g}")
    if drawn["validates"]:
        out.print(f"           agrees with the budget to {drawn['tolerance']:.2g}")
    else:
        out.print(
            f"[yellow]           differs from the budget: by {drawn['low_differs_by']:+.2g} at the lower end and "
            f"{drawn['high_differs_by']:+.2g} at the upper, more than {drawn['tolerance']:.2g}[/yellow]; "
            "quote this one"
        )


def _show(reading: Reading, *, budget: bool) -> None:
    out = console()
    value = reading.radiance
    k, limit, luminance = reading.coverage_factor, reading.upper_limit, reading.luminance
    if limit is None:
        shown, share = with_u(value.value, k * value.u, value.unit), f"{100 * reading.expanded_u_rel:.2g}"
        out.print(f"radiance   [bold]{shown}[/bold]   (k = {k:.3g}, {share} %)")
    else:
        out.print(f"radiance   [bold]{below(limit.value, limit.unit)}[/bold]")
    if luminance and limit is None:
        out.print(f"luminance  {with_u(luminance.value, k * luminance.u, luminance.unit, k=k)}")
    elif luminance:
        out.print(f"luminance  {below(upper_limit(luminance.value, luminance.u), luminance.unit)}")
    if reading.band_nm:
        out.print("band       {:g} to {:g} nm".format(*reading.band_nm))
    exposures = ", ".join(_time(t) for t in sorted(set(reading.exposures_s)))
    out.print(f"exposures  {exposures}")
    for flag in reading.flags:
        out.print(f"[yellow]flag       {flag}[/yellow]: {FLAG_MEANINGS[flag]}")
    if budget:
        _show_budget(reading)
    if "monte_carlo" in reading.more:
        _show_distribution(reading)


def _time(seconds: float) -> str:
    unit, scale = ("s", 1.0) if seconds >= 1 else ("ms", 1e-3) if seconds >= 1e-3 else ("µs", 1e-6)
    return f"{seconds / scale:.4g} {unit}"


_ENDLESS: Final = 1e5  # degrees of freedom: Student's t is the normal distribution to 5 digits


def _show_budget(reading: Reading) -> None:
    from rich.table import Table

    total = sum(entry.u_rel**2 for entry in reading.budget) or 1.0
    table = Table(title="uncertainty budget (k = 1)", title_justify="left")
    for heading in ("contribution", "u rel. %", "share %", "type", "dof", "from"):
        table.add_column(heading, justify="right" if "%" in heading or heading == "dof" else "left")
    for entry in sorted(reading.budget, key=lambda contribution: -contribution.u_rel):
        dof = f"{entry.degrees_of_freedom:.0f}" if entry.degrees_of_freedom < _ENDLESS else "∞"
        share = 100 * entry.u_rel**2 / total
        table.add_row(entry.name, f"{100 * entry.u_rel:.3f}", f"{share:.1f}", entry.kind, dof, entry.note)
    console().print(table)
