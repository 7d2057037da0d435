"""`radiometer bracket`: capture a set of exposures of an unmoving scene."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.arguments import parse_patch, parse_seconds
from radiometer.cli.console import note, progress_bar, shutter_by_hand
from radiometer.cli.outputs import writes
from radiometer.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from radiometer.acquire.bracketing import BracketRequest
    from radiometer.acquire.exposure_plan import ExposurePlan
    from radiometer.bench.config import BenchConfig
    from radiometer.data import CaptureSet, Patch
    from radiometer.devices import Camera


@writes(folder="out")
def command(
    out: Annotated[Path, typer.Argument(help="Folder to create.")],
    camera: Annotated[
        str | None, typer.Option(help="sim, a GenICam id, serial number or address, or v4l2:, picamera:, gphoto2:.")
    ] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    patch: Annotated[str | None, typer.Option(help="Choose the exposures for this region X,Y,W,H only.")] = None,
    stops: Annotated[float | None, typer.Option(help="Fixed ladder: distance of the exposures in stops.")] = None,
    shortest: Annotated[
        str | None, typer.Option("--from", help="Fixed ladder: shortest exposure (1/125, 8ms).")
    ] = None,
    longest: Annotated[str | None, typer.Option("--to", help="Fixed ladder: longest exposure.")] = None,
    repeat: Annotated[int, typer.Option(min=1, help="Take every exposure this often.")] = 1,
    u_rel: Annotated[float | None, typer.Option(help="Repeat until noise is below this relative u (k = 1).")] = None,
    darks: Annotated[int, typer.Option(min=0, help="Dark frames per exposure time.")] = 0,
    plan: Annotated[Path | None, typer.Option(help="Take the frames of this plan (from `reconcile --plan`).")] = None,
    time_limit: Annotated[float, typer.Option(min=0.0, help="Bound on the sum of exposure times in s.")] = 60.0,
    json: Annotated[bool, typer.Option("--json", help="Report as JSON on standard output.")] = False,
) -> None:
    """Capture a set of exposures of an unmoving scene.

    Meters the scene and takes the fewest and shortest exposures that expose every pixel well at least twice, or
    the fixed ladder of --stops, --from and --to. Writes one folder with `capture.yaml`, finished or not at all.
    """
    from radiometer.acquire.bracketing import BracketRequest
    from radiometer.bench.assembly import open_bench_camera

    region = parse_patch(patch) if patch else None
    ladder = _ladder_bounds(stops, shortest, longest)
    request = BracketRequest(region, u_rel, time_limit, darks)
    if plan and (ladder or region or u_rel is not None or darks or repeat > 1):
        raise UsageError("--plan says everything itself; leave out --stops, --from, --to, --patch, --u-rel, --darks")
    with open_bench_camera(bench, camera) as (config, device):
        if plan:
            _follow(out, device, plan, config)
            return
        exposures = _plan(device, request, ladder, repeat)
        written = capture_into(out, device, exposures, request, config)
        _report(written, exposures, region, as_json=json)


def _ladder_bounds(stops: float | None, shortest: str | None, longest: str | None) -> tuple[float, float, float] | None:
    if stops is None and shortest is None and longest is None:
        return None
    if shortest is None or longest is None:
        raise UsageError("a fixed ladder needs --from and --to (and --stops, 1 by default)")
    return (
        parse_seconds(shortest, "--from"),
        parse_seconds(longest, "--to"),
        1.0 if stops is None else stops,
    )


def _plan(
    device: Camera, request: BracketRequest, ladder: tuple[float, float, float] | None, repeat: int
) -> ExposurePlan:
    from dataclasses import replace

    from radiometer.acquire.bracketing import plan_for_scene
    from radiometer.acquire.exposure_plan import exposure_ladder

    if ladder:
        shortest_s, longest_s, stops = ladder
        return exposure_ladder(shortest_s, longest_s, stops, device.capabilities.exposure_s, repeat)
    plan = plan_for_scene(device, request)
    return replace(plan, exposures_s=tuple(sorted(plan.exposures_s * repeat)))


def capture_into(
    out: Path,
    device: Camera,
    plan: ExposurePlan,
    request: BracketRequest,
    config: BenchConfig,
) -> CaptureSet:
    """Capture the planned exposures into a new folder, with a progress bar, and return what was written."""
    from radiometer.acquire.bracketing import take_plan
    from radiometer.bench.assembly import known_patches
    from radiometer.data import CaptureSet, CaptureSetWriter
    from radiometer.data.provenance import utc_now

    shutter = (
        shutter_by_hand(device.identity.model) if request.dark_frames and not device.capabilities.has_shutter else None
    )
    total = len(plan.exposures_s) + request.dark_frames * len(set(plan.exposures_s))
    camera, lens, patches = device.description, device.lens, known_patches(config)
    dated: dict[str, object] = {"created": utc_now()}
    with CaptureSetWriter(out, camera, lens, config.source, patches, extra=dated) as writer, progress_bar() as bar:
        task = bar.add_task("capturing", total=total)
        for frame in take_plan(device, plan, request, close_shutter=shutter):
            writer.add(frame)
            bar.advance(task)
    return CaptureSet.read(out)


def _follow(out: Path, device: Camera, file: Path, config: BenchConfig) -> None:
    from radiometer.acquire.capture_plan import read_capture_plan, take_capture_plan
    from radiometer.bench.assembly import known_patches
    from radiometer.bench.staging import stage_of
    from radiometer.data import CaptureSetWriter
    from radiometer.data.provenance import utc_now

    plan = read_capture_plan(file)
    patterns = tuple(dict.fromkeys(planned.pattern for planned in plan.frames))
    dated: dict[str, object] = {"created": utc_now()}
    header = (device.description, device.lens, config.source, known_patches(config), patterns)
    with CaptureSetWriter(out, *header, extra=dated) as writer, progress_bar() as bar:
        task = bar.add_task("capturing", total=plan.total)
        for frame in take_capture_plan(device, plan, stage_of(device, _ask_for)):
            writer.add(frame)
            bar.advance(task)
    note(f"{out}: {plan.total} frames at {len(plan.frames)} settings as planned")


def _ask_for(wish: str) -> None:
    if not sys.stdin.isatty():
        raise DeviceError(f"the plan needs a hand: {wish}; run at a terminal")
    typer.confirm(f"Please {wish}. Done?", abort=True, err=True)


def _report(written: CaptureSet, plan: ExposurePlan, region: Patch | None, *, as_json: bool) -> None:
    from radiometer.acquire.reach import assess_reach

    reach = assess_reach(written.frames(), written.header.camera, region)
    exposures = [entry.exposure_s for entry in written.header.frames if entry.shutter == "open"]
    late = len(plan.exposures_s) - len(exposures)
    missing = reach.sentences() + (["the time limit left out the longest exposures"] if plan.cut_short else [])
    missing += [f"the deadline came before {late} of {len(plan.exposures_s)} exposures"] if late > 0 else []
    if as_json:
        report = {
            "capture": str(written.path),
            "frames": len(written),
            "exposures_s": exposures,
            "dark_frames": len(written) - len(exposures),
            "pixels": int(reach.cover.size),
            "well_exposed_twice": int((reach.cover >= 2).sum()),
            "saturated": int(reach.saturated.sum()),
            "below_noise": int(reach.below_noise.sum()),
            "cut_short": plan.cut_short or late > 0,
        }
        print(json_module.dumps(report))
        return
    note(f"{written.path}: {len(exposures)} exposures from {min(exposures):.4g} s to {max(exposures):.4g} s")
    pixels = "patch's pixels" if region else "pixels"
    note(f"{100 * float((reach.cover >= 2).mean()):.2f} % of the {pixels} are well exposed at least twice")
    for sentence in missing:
        note(f"not reached: {sentence}")
