"""`radiometer bracket`: capture a set of exposures of an unmoving scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_exposure, parse_patch
from radiometer.cli.console import asker, note, progress
from radiometer.cli.options import BenchOption, CameraOption, JsonOption, URelOption
from radiometer.cli.outputs import writes
from radiometer.plausible import AnyCount, Count, NotNegative, Positive


@writes(folder="out")
def command(
    out: Annotated[Path, typer.Argument(help="Folder to create.")],
    camera: CameraOption = None,
    bench: BenchOption = None,
    patch: Annotated[str | None, typer.Option(help="Choose the exposures for this region X,Y,W,H only.")] = None,
    stops: Annotated[Positive | None, typer.Option(help="Fixed ladder: distance of the exposures in stops.")] = None,
    shortest: Annotated[
        str | None, typer.Option("--from", help="Fixed ladder: shortest exposure (1/125, 8ms).")
    ] = None,
    longest: Annotated[str | None, typer.Option("--to", help="Fixed ladder: longest exposure.")] = None,
    repeat: Annotated[Count, typer.Option(help="Take every exposure this often.")] = 1,
    u_rel: URelOption = None,
    darks: Annotated[AnyCount, typer.Option(help="Dark frames per exposure time.")] = 0,
    plan: Annotated[Path | None, typer.Option(help="Take the frames of this plan (from `reconcile --plan`).")] = None,
    time_limit: Annotated[NotNegative, typer.Option(help="Bound on the sum of exposure times in s.")] = 60.0,
    json: JsonOption = False,
) -> None:
    """Capture a set of exposures of an unmoving scene.

    Meters the scene and takes the fewest and shortest exposures that expose every pixel well at least twice, or
    the fixed ladder of --stops, --from and --to. Writes one folder with `capture.yaml`, finished or not at all.
    """
    with progress(shown=not json) as shown:
        found = rm.bracket(
            out, camera=camera, bench=bench, patch=parse_patch(patch), stops=stops,
            shortest_s=parse_exposure(shortest, "--from"), longest_s=parse_exposure(longest, "--to"), repeat=repeat,
            u_rel=u_rel, darks=darks, plan=plan, time_limit_s=time_limit, ask=asker(),
            progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
        return
    if not found.coverage:
        note(f"{out}: {found.frames} frames as planned")
        return
    note(str(found))
    pixels = "patch's pixels" if patch else "pixels"
    share = found.coverage["well_exposed_twice"] / found.coverage["pixels"]
    note(f"{100 * share:.2f} % of the {pixels} are well exposed at least twice")
    for sentence in found.not_reached:
        note(f"not reached: {sentence}")
