"""`radiometer simulate`: simulated devices, served as if they were real.

A Blackfly S over GigE Vision in a separate process, and a light box on a pseudo-terminal.
"""

from __future__ import annotations

import functools
import select
import signal
import sys
import time
from typing import Any

import typer

from radiometer.cli.function import command_of
from radiometer.cli.options import command_group, time_option

app = command_group("Serve a simulated device.")
_line = functools.partial(print, flush=True)


def _ready(port: str) -> None:
    _line(port)
    _line("the light box is served; stop with Ctrl-C", file=sys.stderr)


def _entered(timeout_s: float) -> bool:
    """Wait a moment; return whether Enter was pressed on the terminal."""
    if not sys.stdin or not sys.stdin.isatty():
        time.sleep(timeout_s)
        return False
    ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
    return bool(ready and sys.stdin.readline())


_box = command_of(
    "simulate_box", serves=lambda json, **given: {"ready": _ready, "entered": _entered},
    serial=typer.Option(), link=typer.Option(),
    reset_every_s=time_option("--reset-every"), press_every_s=time_option("--press-every"),
)  # fmt: skip


@functools.wraps(_box)
def _box_until_a_signal(**given: Any) -> int:
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # its end takes the port's link away as Ctrl-C does
    return _box(**given)


app.command("camera")(
    command_of(
        "simulate_camera", serves=lambda json, **given: {"ready": _line}, scene=typer.Option(),
        real_time=typer.Option("--real-time/--fast"),
    )
)  # fmt: skip
app.command("box")(_box_until_a_signal)
