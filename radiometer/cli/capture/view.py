"""`radiometer view`: what the camera sees, live on a page."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import typer

from radiometer.cli.function import command_of
from radiometer.cli.options import BenchOption

if TYPE_CHECKING:
    from radiometer import Patch


def _show(chosen: Patch) -> None:
    print(f"--patch {chosen.x},{chosen.y},{chosen.width},{chosen.height}")


command = command_of(
    "view", _show, json=False, page="live view, until Ctrl-C:\n  {}", camera=typer.Option(), bench=BenchOption,
    serves=lambda json, **given: {"notice": partial(print, flush=True), "sleep": time.sleep},
)  # fmt: skip
