"""`radiometer characterise`: gain, noise, dark current, saturation and linearity of a camera after EMVA 1288."""

from __future__ import annotations

import json as json_module
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import console, note, progress_bar
from radiometer.cli.outputs import writes
from radiometer.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from radiometer.analysis.characterise import Characterisation, Subject
    from radiometer.bench.config import BenchConfig
    from radiometer.data import LensDescription, Patch
    from radiometer.devices import Camera, CameraCapabilities


@writes("output", "report", "emva_descriptor", folder="keep")
def command(
    capture: Annotated[
        Path | None, typer.Argument(help="Capture set, or EMVA 1288 descriptor file; or else --camera.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Camera file (YAML) to write.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="Drive this camera: sim, or a GenICam id, serial number or address.")
    ] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    patch: Annotated[str | None, typer.Option(help="Look at this region X,Y,W,H only.")] = None,
    radiance: Annotated[
        float | None,
        typer.Option(min=0.0, help="Known radiance of the region in W/(sr m2), for the quantum efficiency."),
    ] = None,
    radiance_u_rel: Annotated[float, typer.Option(min=0.0, help="Its relative standard uncertainty.")] = 0.0,
    steps: Annotated[int, typer.Option(min=6, help="With --camera: exposures from darkness to saturation.")] = 30,
    keep: Annotated[Path | None, typer.Option(help="With --camera: keep the frames as a capture set here.")] = None,
    report: Annotated[Path | None, typer.Option(help="Report (HTML) to write: outcome, pictures, figures.")] = None,
    emva_descriptor: Annotated[
        Path | None, typer.Option(help="EMVA 1288 descriptor file to write, for other programs.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the camera file as JSON on standard output.")] = False,
) -> None:
    """Find gain, noise, dark current, saturation and linearity of a camera after EMVA 1288.

    Needs pairs of frames of steady, even light over exposure or level, and dark frames; takes them itself from
    --camera. Every figure carries its standard uncertainty.
    """
    if (capture is None) == (camera is None):
        raise UsageError("name a capture set (or descriptor file), or a camera with --camera; one of both")
    from radiometer.analysis.characterise import characterise, read_subject

    region = parse_patch(patch) if patch else None
    with _frames(capture, camera, bench, region, steps, keep, shown=not json) as (path, region, limits):
        subject = _with_radiance(read_subject(path, region), path, region, radiance, radiance_u_rel)
        if camera is not None and keep is None:
            subject = replace(subject, origin=f"camera {camera}")
        result = characterise(subject)
        if emva_descriptor:
            from radiometer.analysis.characterise.emva_export import export_descriptor

            for remark in export_descriptor(subject, result, emva_descriptor):
                note(remark)
    _write(result, limits, output, report)
    if json:
        print(json_module.dumps(result.to_mapping(limits), ensure_ascii=False, allow_nan=False))
    else:
        _show(result, output, report)


@contextmanager
def _frames(
    capture: Path | None,
    camera: str | None,
    bench: Path | None,
    region: Patch | None,
    steps: int,
    keep: Path | None,
    *,
    shown: bool,
) -> Iterator[tuple[Path, Patch | None, dict[str, Any] | None]]:
    """Give the frames' folder, the region and the camera's limits; takes the frames where a camera is named."""
    if capture is not None:
        yield capture, region, None
        return
    from radiometer.bench.assembly import open_bench_camera
    from radiometer.bench.instrument import central_patch

    with tempfile.TemporaryDirectory(prefix="radiometer-") as scratch:
        folder = keep or Path(scratch) / "capture"
        with open_bench_camera(bench, camera) as (config, device):
            where = region or (config.patch.patch if config.patch else central_patch(device))
            _take(device, config, where, steps, folder, shown=shown)
            limits = _limits(device.capabilities)
        yield folder, None, limits


def _take(device: Camera, config: BenchConfig, region: Patch, steps: int, folder: Path, *, shown: bool) -> None:
    """Write the frames of the ladder; only the region of each is kept, so that they take little room."""
    from radiometer.acquire.characterisation_ladder import LadderRequest, take_ladder
    from radiometer.data import CaptureSetWriter, PatchDescription

    request = LadderRequest(region, steps)
    shutter = None if device.capabilities.has_shutter else _shutter_by_hand(device)
    patch = PatchDescription(name="region", x=0, y=0, width=region.width, height=region.height)
    with (
        CaptureSetWriter(folder, device.description, _shifted(device, region), config.source, (patch,)) as writer,
        progress_bar(shown=shown) as bar,
    ):
        task = bar.add_task("capturing", total=request.frames())
        for frame in take_ladder(device, request, shutter):
            writer.add(replace(frame, dn=frame.dn[region.slices].copy()))
            bar.advance(task)


def _shifted(device: Camera, region: Patch) -> LensDescription:
    """Return the lens with its principal point counted from the region's corner."""
    capabilities, lens = device.capabilities, device.lens
    x, y = lens.principal_point_px or ((capabilities.width - 1) / 2, (capabilities.height - 1) / 2)
    return lens.model_copy(update={"principal_point_px": (x - region.x, y - region.y)})


def _shutter_by_hand(device: Camera) -> Callable[[bool], None]:
    if not sys.stdin.isatty():
        raise DeviceError(
            f"{device.identity.model} has no shutter for dark frames; run at a terminal, where you are asked to cover "
            "the lens"
        )

    def ask(closed: bool) -> None:
        typer.confirm(f"{'Cover' if closed else 'Uncover'} the lens. Done?", abort=True, err=True)

    return ask


def _limits(capabilities: CameraCapabilities) -> dict[str, Any]:
    from dataclasses import asdict

    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(capabilities).items()}


def _with_radiance(subject: Subject, path: Path, region: Patch | None, radiance: float | None, u_rel: float) -> Subject:
    """Return the subject with the photon flux that a radiance given by hand makes on its regions."""
    if radiance is None:
        return subject
    from radiometer.analysis.characterise.photon_flux import photon_flux
    from radiometer.data import PatchDescription
    from radiometer.importing import open_capture

    capture = open_capture(path)
    header, (height, width) = capture.header, capture.read_frame(0).shape
    fluxes = []
    for where in subject.regions:
        x, y, w, h = (where.x, where.y, where.width, where.height) if where else (0, 0, width, height)
        known = PatchDescription(name="region", x=x, y=y, width=w, height=h, radiance_W_per_sr_m2=radiance, u_rel=u_rel)
        f_number = header.frames[0].f_number
        fluxes.append(
            photon_flux(known, "default", header.camera, header.lens, header.source, f_number, (height, width))
        )
    if None in fluxes:
        raise UsageError(
            f"--radiance gives no photons: {path} must state pixel_pitch_um, f_number and the source's wavelength_nm"
        )
    return replace(subject, fluxes=tuple(fluxes))


def _write(result: Characterisation, limits: dict[str, Any] | None, output: Path | None, report: Path | None) -> None:
    from radiometer.data.storage import write_text_atomic, write_yaml_atomic

    if output:
        write_yaml_atomic(output, result.to_mapping(limits))
    if report:
        from radiometer.analysis.characterise.report import datasheet

        write_text_atomic(report, datasheet(result))


def _show(result: Characterisation, output: Path | None, report: Path | None) -> None:
    from rich.table import Table

    from radiometer.analysis.characterise.symbols import SYMBOLS, as_printed

    out = console()
    table = Table(title=f"EMVA 1288 figures at {result.gain_db:g} dB", title_justify="left")
    for heading in ("symbol", "figure", "value", "U (k = 2)", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "U (k = 2)") else "left")
    for key, symbol in SYMBOLS.items():
        if key in result.figures:
            value, expanded = as_printed(key, result.figures[key])
            unit = result.figures[key].unit
            table.add_row(symbol.sign, symbol.meaning, value, expanded, "" if unit == "1" else unit)
    out.print(table)
    for remark in result.notes:
        out.print(f"[yellow]note[/yellow]  {remark}")
    for written in (output, report):
        if written:
            note(f"wrote {written}")
