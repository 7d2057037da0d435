"""`radiometer quality`: the instrument's own datasheet, index by index, from captures that it asks for."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import console, note, progress_bar
from radiometer.cli.outputs import writes
from radiometer.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from radiometer.acquire.exposure_plan import ExposurePlan
    from radiometer.analysis.quality.procedures import Procedure, ProcedureStep
    from radiometer.analysis.quality.session import Datasheet
    from radiometer.bench.config import BenchConfig
    from radiometer.data import Calibration, Patch, PatchDescription
    from radiometer.data.calibration_sections import SpectralResponse
    from radiometer.devices import Camera

app = typer.Typer(
    help="Measure the instrument's quality indices (ISO/CIE 19476, CIE 244, ISO 9358) and write its datasheet.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_OVER = 64.0  # so many times beyond full scale the source of smear is exposed
_LADDER_SPAN, _LADDER_STOPS = 40.0, 0.5
_FEWEST_FRAMES = 5


@app.command("plan")
def plan(json: Annotated[bool, typer.Option("--json", help="As JSON on standard output.")] = False) -> None:
    """List the indices, what each asks for, and how it is defined."""
    from dataclasses import asdict

    from radiometer.analysis.quality.procedures import PROCEDURES

    if json:
        print(json_module.dumps([asdict(one) for one in PROCEDURES], ensure_ascii=False))
        return
    out = console()
    for one in PROCEDURES:
        out.print(f"[bold]{one.name}[/bold]  {one.symbol}, {one.title} ({one.source})")
        out.print(f"    {one.definition}")
        for step in one.steps:
            out.print(f"    {step.name}: {step.ask}")
        if one.more:
            out.print(f"    and {one.more}")
        if not one.steps:
            out.print("    no captures: from the camera's spectral response")


@app.command("take")
def take(
    session: Annotated[Path, typer.Argument(help="Folder of the session; made where it is missing.")],
    procedure: Annotated[str, typer.Argument(help="Index to capture for; `radiometer quality plan` lists them.")],
    steps: Annotated[list[str] | None, typer.Argument(help="Steps to take; all that are missing by default.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="sim, a GenICam id, serial number or address, or v4l2:, picamera:, gphoto2:.")
    ] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    patch: Annotated[str | None, typer.Option(help="Region X,Y,W,H to read; the bench's by default.")] = None,
    repeat: Annotated[int, typer.Option(min=1, help="Frames of every exposure.")] = 4,
    darks: Annotated[int, typer.Option(min=0, help="Dark frames per exposure time, where there is a shutter.")] = 2,
) -> None:
    """Take the captures of one index, asking for what each step needs.

    Without a terminal name one STEP at a time and arrange the bench yourself.
    """
    from radiometer.analysis.quality.procedures import PROCEDURES
    from radiometer.analysis.quality.procedures import procedure as named
    from radiometer.bench.assembly import open_bench_camera

    wanted = named(procedure)
    if wanted is None or not wanted.steps:
        known = ", ".join(one.name for one in PROCEDURES if one.steps)
        raise UsageError(f"{procedure!r} is no procedure with captures; there are {known}")
    missing = [one for one in _chosen(wanted, steps) if not (session / wanted.name / one.name).exists()]
    if not missing:
        note(f"{session / wanted.name}: all steps are there; remove a folder to take it again")
        return
    if len(missing) > 1 and not sys.stdin.isatty():
        names = ", ".join(one.name for one in missing)
        raise DeviceError(f"the steps {names} need a hand in between; run at a terminal, or name one step at a time")
    for step in missing:
        if sys.stdin.isatty():
            typer.confirm(f"{wanted.title}, step {step.name}: {step.ask}. Ready?", default=True, abort=True, err=True)
        with open_bench_camera(bench, camera) as (config, device):
            chosen = parse_patch(patch) if patch else config.patch.patch if config.patch else None
            if chosen is not None:
                config = config.model_copy(update={"patches": (_described(chosen),)})
            _take(session / wanted.name / step.name, wanted, device, config, repeat, darks)


def _chosen(wanted: Procedure, names: list[str] | None) -> list[ProcedureStep]:
    from radiometer.analysis.quality.procedures import ProcedureStep

    if not names:
        return list(wanted.steps)
    known = {one.name: one for one in wanted.steps}
    unknown = [name for name in names if name not in known]
    if any("/" in name or name.startswith(".") for name in unknown) or (unknown and not wanted.more):
        raise UsageError(f"{unknown[0]!r} is no step of {wanted.name}; there are {', '.join(known)}")
    return [known.get(name) or ProcedureStep(name, f"as for the others, at {name}") for name in names]


def _described(patch: Patch) -> PatchDescription:
    from radiometer.data import PatchDescription

    return PatchDescription(name="patch", x=patch.x, y=patch.y, width=patch.width, height=patch.height)


def _take(out: Path, wanted: Procedure, device: Camera, config: BenchConfig, repeat: int, darks: int) -> None:
    from radiometer.acquire.bracketing import BracketRequest, plan_for_scene
    from radiometer.cli.capture.bracket import capture_into

    region = config.patches[0].patch if config.patches and wanted.exposures != "scene" else None
    count = darks if device.capabilities.has_shutter else 0
    request = BracketRequest(region, None, 60.0, count)
    exposures = _exposures(plan_for_scene(device, request), wanted, device, repeat)
    written = capture_into(out, device, exposures, request, config)
    note(f"{out}: {len(written)} frames")


def _exposures(planned: ExposurePlan, wanted: Procedure, device: Camera, repeat: int) -> ExposurePlan:
    """Return the exposures of a procedure from those that the patch needs."""
    from dataclasses import replace

    from radiometer.acquire.exposure_plan import exposure_ladder

    low, high = device.capabilities.exposure_s
    longest = max(planned.exposures_s)
    if wanted.exposures == "ladder":
        return exposure_ladder(max(longest / _LADDER_SPAN, low), longest, _LADDER_STOPS, (low, high), repeat)
    if wanted.exposures == "overexposed":
        return exposure_ladder(max(longest, low), min(_OVER * longest, high), 2.0, (low, high), repeat)
    times = planned.exposures_s * repeat
    while len(times) < _FEWEST_FRAMES:
        times += planned.exposures_s
    return replace(planned, exposures_s=tuple(sorted(times)))


@app.command("report")
@writes("out")
def report(
    session: Annotated[Path, typer.Argument(help="Folder of the session.")],
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file: its corrections are part of the instrument.")
    ] = None,
    patch: Annotated[str | None, typer.Option(help="Region X,Y,W,H to read; each capture's own by default.")] = None,
    source_u_rel: Annotated[
        float, typer.Option(min=0.0, help="Relative u (k = 1) of the source's steadiness between steps.")
    ] = 0.001,
    spectral_response: Annotated[
        Path | None, typer.Option(help="CSV of wavelength in nm and relative responsivity per watt; for f1′.")
    ] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Write the datasheet as HTML.")] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON on standard output.")] = False,
) -> None:
    """Find every index that the captures allow, and write the datasheet; the others are listed as not measured."""
    from radiometer.analysis.quality.session import Evaluation, evaluate

    known = _calibration(calibration)
    response = _response(spectral_response)
    how = Evaluation(known, parse_patch(patch) if patch else None, source_u_rel, response)
    with progress_bar(shown=not json) as bar:
        task = bar.add_task("reading", total=None)
        sheet = evaluate(session, how, lambda title: bar.update(task, description=title))
    if out is not None:
        from radiometer.analysis.quality.datasheet import write_datasheet

        write_datasheet(out, sheet)
        note(f"{out}: the datasheet")
    if json:
        print(json_module.dumps(sheet.to_mapping(), ensure_ascii=False, allow_nan=False))
        return
    _show(sheet)


def _calibration(path: Path | None) -> Calibration | None:
    from radiometer.data import Calibration

    return Calibration.read(path) if path else None


def _response(path: Path | None) -> SpectralResponse | None:
    if path is None:
        return None
    from radiometer.api.calibration import read_spectral_response

    return read_spectral_response(path)


def _show(sheet: Datasheet) -> None:
    from rich.table import Table

    from radiometer.analysis.quality.datasheet import shown

    table = Table(title="quality indices (± at 95.45 %)", title_justify="left")
    for heading in ("index", "of", "value", "±"):
        table.add_column(heading, justify="right" if heading in ("value", "±") else "left")
    for one in sheet.indices:
        if one.figure is not None:
            table.add_row(one.procedure.symbol, one.procedure.title, *shown(one.figure))
    console().print(table)
    for one in sheet.indices:
        if one.figure is None:
            note(f"not measured: {one.procedure.symbol}, {one.procedure.title}: {one.reason}")
        for remark in one.figure.remarks if one.figure else ():
            note(f"{one.procedure.symbol}: {remark}")
    for assumption in sheet.assumptions:
        note(f"assumed: {assumption}")
