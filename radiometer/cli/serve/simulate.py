"""`radiometer simulate`: simulated devices, served as if they were real.

A Blackfly S over GigE Vision in a separate process, and a light box on a pseudo-terminal.
"""

from __future__ import annotations

import select
import signal
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_seconds
from radiometer.cli.options import BenchOption, command_group
from radiometer.plausible import AnyCount, Duration, FilterDensity, PerMille, Seed, Share

app = command_group("Serve a simulated device.")


@app.command("camera")
def simulate_camera(
    scene: Annotated[
        str | None, typer.Option(help="YAML file of a scene, a picture, or a kind of scene; the bench's by default.")
    ] = None,
    serial: Annotated[str | None, typer.Option(help="Serial number; the bench's by default.")] = None,
    bench: BenchOption = None,
    address: Annotated[str, typer.Option(help="Address of a network interface of this computer.")] = "127.0.0.1",
    seed: Annotated[Seed | None, typer.Option(help="Makes the noise; the bench's by default.")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time/--fast", help="Frames take their exposure time, or come as they are made.")
    ] = True,
    lose_per_mille: Annotated[PerMille, typer.Option(help="Packets lost of a thousand.")] = 0,
    answer_delay: Annotated[Duration, typer.Option(help="Seconds by which frames and answers are late.")] = 0.0,
    stall_after: Annotated[AnyCount | None, typer.Option(help="Stop sending after so many frames.")] = None,
    drop_after: Annotated[AnyCount | None, typer.Option(help="Fall silent after so many frames.")] = None,
    frame_pool: Annotated[
        AnyCount, typer.Option(help="Serve so many frames again and again; 0 makes every frame anew.")
    ] = 0,
    awkward: Annotated[
        bool,
        typer.Option("--awkward", help="As awkward as a real one: no Mono12, chunks, stale frames, locked features."),
    ] = False,
) -> None:
    """Serve a simulated Blackfly S that any GenICam program can open, until stopped by Ctrl-C.

    Its pictures come from the forward model: the bench's camera, lens and scene. As shipped, automatic exposure, gamma
    and sharpening are on. Faults can also be set over the wire, by the features SimPacketLossPerMille, SimStall,
    SimAnswerDelay and SimDisconnect.
    """
    rm.simulate_camera(
        scene, serial=serial, bench=bench, address=address, seed=seed, real_time=real_time,
        lose_per_mille=lose_per_mille, answer_delay_s=answer_delay, stall_after=stall_after, drop_after=drop_after,
        frame_pool=frame_pool, awkward=awkward, ready=lambda line: print(line, flush=True),
    )  # fmt: skip


@app.command("box")
def simulate_box(
    serial: Annotated[str, typer.Option(help="Serial number: eight letters or digits.")] = "TWIN0001",
    link: Annotated[Path | None, typer.Option(help="Name of its port; where boxes are looked for by default.")] = None,
    firmware: Annotated[
        Path | None, typer.Option(help="Run this firmware (light_box.hex) in simavr instead of the twin.")
    ] = None,
    clock_ppm: Annotated[float, typer.Option(help="Rate of its clock above true time, ppm.")] = 0.0,
    corrupt: Annotated[Share, typer.Option(help="Share of bytes that the line damages.")] = 0.0,
    drop: Annotated[Share, typer.Option(help="Share of bytes that the line loses.")] = 0.0,
    reset_every: Annotated[str | None, typer.Option(help="Restart the box this often, such as 30s.")] = None,
    press_every: Annotated[str | None, typer.Option(help="Press the button this often for 0.2 s.")] = None,
    seed: Annotated[Seed, typer.Option(help="Makes the line's faults and the subject's answers.")] = 0,
    subject: Annotated[
        str | None, typer.Option(help="Simulated subject before it, for `adapt run`: steady, never, always, leaves.")
    ] = None,
    filter_density: Annotated[
        FilterDensity, typer.Option(help="Density of the neutral filter between spot and subject.")
    ] = 3.0,
) -> None:
    """Serve a simulated light box that any serial program can open, until stopped by Ctrl-C.

    Its first line on standard output is the name of its port. On a terminal, Enter presses the button for 0.2 s.
    """

    def ready(port: str) -> None:
        print(port, flush=True)
        print(f"light box {serial} is served; stop with Ctrl-C", file=sys.stderr, flush=True)

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # its end takes the port's link away as Ctrl-C does
    rm.simulate_box(
        serial, link, firmware=firmware, clock_ppm=clock_ppm, corrupt=corrupt, drop=drop,
        reset_every_s=parse_seconds(reset_every, "--reset-every"),
        press_every_s=parse_seconds(press_every, "--press-every"), seed=seed, subject=subject,
        filter_density=filter_density, ready=ready, entered=_entered,
    )  # fmt: skip


def _entered(timeout_s: float) -> bool:
    """Wait a moment; return whether Enter was pressed on the terminal."""
    if not sys.stdin or not sys.stdin.isatty():
        time.sleep(timeout_s)
        return False
    ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
    return bool(ready and sys.stdin.readline())
