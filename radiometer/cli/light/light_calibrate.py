"""`radiometer light calibrate`: radiance over level, measured by the camera."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import console, note, progress_bar
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.data.light_calibration import LightCalibration


@writes("out")
def calibrate(
    channel: Annotated[list[str] | None, typer.Option(help="Channel to calibrate; may be repeated; all.")] = None,
    box: Annotated[str | None, typer.Option("--box", help="sim, a serial number or a port.")] = None,
    camera: Annotated[str | None, typer.Option(help="sim, or a GenICam id, serial number or address.")] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file of the camera.")] = None,
    patch: Annotated[str | None, typer.Option(help="Lit area in the frame, X,Y,W,H in pixels.")] = None,
    camera_calibration: Annotated[Path | None, typer.Option(help="Camera calibration; the bench's by default.")] = None,
    points_per_decade: Annotated[float, typer.Option(min=1.0, max=50.0, help="Density of the levels.")] = 4.0,
    responsivity: Annotated[
        Path | None, typer.Option(help="CSV wavelength_nm,responsivity (per W) of the camera; flat QE without.")
    ] = None,
    spectral_u_rel: Annotated[
        float | None, typer.Option(min=0.0, help="Relative u of the spectral correction (k = 1).")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Makes the random order of the levels.")] = None,
    preset: Annotated[Path | None, typer.Option(help="Light-box preset with safety bounds.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="File to write; the box's own by default.")] = None,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Measure each channel's radiance over its levels with the camera, on both current ranges.

    Levels come in random order, each after it has settled; the dark reading is taken off, a reference level measured
    in between tells the drift. What is written makes `radiometer light set spot --radiance 0.01` work.
    """
    from radiometer.api.outputs import check_outputs
    from radiometer.bench.boxes import calibration_file, open_light_box
    from radiometer.bench.light_bench import SurveyRequest, open_light_camera, survey_box

    area = parse_patch(patch) if patch else None
    with (
        open_light_box(box, preset=preset) as opened,
        open_light_camera(opened, camera, bench, area, camera_calibration) as instrument,
        progress_bar(shown=not json) as bar,
    ):
        channels = tuple(channel or opened.box.channels)
        _refuse_unknown(channels, tuple(opened.box.channels))
        file = out or calibration_file(opened.box.identity.serial)
        if out is None:
            file.parent.mkdir(parents=True, exist_ok=True)
            known = opened.calibration.channels if opened.calibration else {}
            check_outputs(file, force=force or not set(channels) & set(known))  # the other channels of the file stay
        task = bar.add_task("calibrating", total=None)
        request = SurveyRequest(channels, points_per_decade, seed, responsivity, spectral_u_rel)
        found = survey_box(
            opened,
            instrument,
            request,
            lambda name, done, total: bar.update(task, description=name, completed=done, total=total),
        )
    found.write(file)
    _tell(found, channels, file, json=json)


def _tell(found: LightCalibration, channels: tuple[str, ...], file: Path, *, json: bool) -> None:
    report = {
        name: {
            "limits_W_per_sr_m2": found.limits(name),
            "points": len(found.channels[name].points),
            "common_u_rel": found.channels[name].common_u_rel,
            "drift_u_rel": found.channels[name].drift_u_rel,
            "settle_s": found.channels[name].settle_s,
        }
        for name in channels
    }
    if json:
        print(json_module.dumps({"box": found.box_serial, "file": str(file), "channels": report}))
        return
    for name, entry in report.items():
        low, high = found.limits(name)
        u_rel = 2e2 * found.channels[name].common_u_rel
        console().print(
            f"{name:<10} {low:.3g} to {high:.3g} W·sr⁻¹·m⁻²  ± {u_rel:.2g} % (k = 2)  {entry['points']} levels"
        )
    for assumption in found.provenance.assumptions:
        note(f"assumed: {assumption}")
    console().print(f"written    {file}")


def _refuse_unknown(wanted: tuple[str, ...], there: tuple[str, ...]) -> None:
    for name in wanted:
        if name not in there:
            raise UsageError(f"the box has no channel {name!r}; it has {', '.join(there)}")
