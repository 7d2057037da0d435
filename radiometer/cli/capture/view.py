"""`radiometer view`: what the camera sees, live on a page."""

from __future__ import annotations

import webbrowser
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note
from radiometer.cli.options import BenchOption, CameraOption, PatchOption
from radiometer.plausible import Period, Port


def command(
    camera: CameraOption = None,
    patch: PatchOption = None,
    bench: BenchOption = None,
    port: Annotated[Port, typer.Option(help="Port of the page; 0 for any free one.")] = 0,
    every: Annotated[Period, typer.Option(help="Seconds between two pictures.")] = 0.3,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in this machine's browser.")] = False,
) -> None:
    """Show what the camera sees on a page: picture, histogram, clipping.

    A rectangle drawn in the picture becomes the patch: --patch is printed, and a button writes it into the bench file.
    Nothing is measured or kept. Ctrl-C ends it.
    """

    def announce(url: str) -> None:
        note("live view, until Ctrl-C:", f"  {url}")
        if open_browser:
            webbrowser.open(url)

    chosen = rm.view(
        camera, parse_patch(patch) if patch else None, bench=bench, port=port, every_s=every, announce=announce,
        notice=lambda line: print(line, flush=True),
    )  # fmt: skip
    print(f"--patch {chosen.x},{chosen.y},{chosen.width},{chosen.height}")
