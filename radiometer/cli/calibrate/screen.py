"""`radiometer screen`: calibrate a screen, look up levels, export to other programs, import from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import parse_numbers
from radiometer.cli.console import console, note, show_lines
from radiometer.cli.function import command_of
from radiometer.cli.options import PrimariesOption, command_group, words
from radiometer.errors import UsageError
from radiometer.numbers import below, rounded, upper_limit, with_u

if TYPE_CHECKING:
    from radiometer import CalibratedScreen, ScreenLevel

app = command_group("Calibrate a screen as a light source, and use the calibration.")
_ARGYLL = Annotated[bool, typer.Option("--argyll", help="Print spotread's line for every level measured.")]


def _show_calibration(found: CalibratedScreen, argyll: bool) -> None:
    for line in found.argyll_lines() if argyll else ():
        print(line)
    for curve in found.calibration.channels.values():
        _print_channel(found, curve)
    for check, finding in found.checks_in_words().items():
        line = f"{check:<10} {finding}"
        console().print(f"[yellow]{line}[/yellow]" if check == "flicker" else line)
    _print_assumptions(found)


def _show_level(found: ScreenLevel) -> None:
    value, u = found.shown.value, found.shown.u
    known = value > 2 * u  # below it only a limit is known
    shown = with_u(value, 2 * u, found.shown.unit, k=2) if known else below(upper_limit(value, u), found.shown.unit)
    console().print(f"level {found.level} of {found.channel} shows {shown}")


def _show_files(found: list[Path]) -> None:
    for written in found:
        console().print(f"wrote {written}")


def _show_import(found: CalibratedScreen) -> None:
    for line in found.taken:
        note(f"taken: {line}")
    for line in found.doubts:
        note(f"doubt: {line}")
    if found.left_out:
        names = ", ".join(found.left_out)
        note(f"{names} left out: their spectra are not known; --primaries names a display type or a CSV")
    for curve in found.calibration.channels.values():
        _print_channel(found, curve)
    _print_assumptions(found)


def _print_assumptions(found: CalibratedScreen) -> None:
    for assumption in found.calibration.provenance.assumptions:
        console().print(f"assumed    {assumption}")


def _print_channel(found: CalibratedScreen, curve: Any) -> None:
    out = console()
    (black, white), limit = found.luminance_range(curve), found.detection_limit(curve)
    out.print(f"[bold]{curve.name}[/bold]: {len(curve.levels)} levels")
    out.print(f"  brightest  {with_u(white.value, 2 * white.u, white.unit, k=2)}")
    if limit is not None:
        out.print(f"  darkest    < {rounded(limit, limit)[0]} cd·m⁻² (limit of detection)")
    else:
        out.print(f"  darkest    {with_u(black.value, 2 * black.u, black.unit, k=2)}")
    for fit in curve.fits().values():
        gamma, off = with_u(fit.parameters["gamma"], 2 * fit.u_gamma, k=2), 100 * fit.rms_rel
        out.print(f"  {fit.model:<16} γ = {gamma}, rms error {off:.2g} %, worst {100 * fit.max_rel:.2g} %")


def _fields(text: str) -> tuple[int, int]:
    columns, cross, rows = text.lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal()):
        raise UsageError(f"--checkers {text!r}: expected COLUMNSxROWS such as 4x4")
    return int(columns), int(rows)


for _name, _made in {
    "calibrate": command_of(
        "screen_calibrate", _show_calibration, files=("out", "plot"),
        defaults={"out": Path("screen.yaml"), "display": "browser", "channels": "grey", "export": ""},
        channels=typer.Option(parser=words, metavar="NAME,NAME,…"),
        export=typer.Option(parser=words, metavar="FORM,FORM,…"), primaries=PrimariesOption,
        shown={"argyll": (False, _ARGYLL)},
    ),
    "report": command_of(
        "screen_report", show_lines, files=("out",), methods=typer.Option(parser=words, metavar="NAME,NAME,…"),
        angles=typer.Option(
            parser=lambda text: parse_numbers(text, "--angles", "degrees such as -30,30"), metavar="DEG,DEG,…"
        ),
        checkers=typer.Option(parser=_fields, metavar="COLUMNSxROWS"),
        defaults={"checkers": "4x4", "display": "browser"}, primaries=PrimariesOption,
    ),
    "verify": command_of(
        "screen_verify", show_lines, defaults={"display": "browser"}, code=lambda found: int(not found.holds)
    ),
    "level": command_of("screen_level", _show_level),
    "export": command_of(
        "screen_export", _show_files, files=(), json=False,
        kinds=typer.Argument(parser=words, metavar="FORM,FORM,…"),
    ),
    "import": command_of(
        "screen_import", _show_import, files=("out",), defaults={"out": Path("screen.yaml"), "meter_u_rel": 0.04},
        primaries=PrimariesOption,
    ),
}.items():  # fmt: skip
    app.command(_name)(_made)
