"""`radiometer simulate camera`: a simulated Blackfly S over GigE Vision in a separate process."""

from __future__ import annotations

from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.options import BenchOption


def command(
    scene: Annotated[
        str | None, typer.Option(help="YAML file of a scene, a picture, or a kind of scene; the bench's by default.")
    ] = None,
    serial: Annotated[str | None, typer.Option(help="Serial number; the bench's by default.")] = None,
    bench: BenchOption = None,
    address: Annotated[str, typer.Option(help="Address of a network interface of this computer.")] = "127.0.0.1",
    seed: Annotated[int | None, typer.Option(min=0, help="Makes the noise; the bench's by default.")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time/--fast", help="Frames take their exposure time, or come as they are made.")
    ] = True,
    lose_per_mille: Annotated[int, typer.Option(min=0, max=1000, help="Packets lost of a thousand.")] = 0,
    answer_delay: Annotated[float, typer.Option(min=0.0, help="Seconds by which frames and answers are late.")] = 0.0,
    stall_after: Annotated[int | None, typer.Option(min=0, help="Stop sending after so many frames.")] = None,
    drop_after: Annotated[int | None, typer.Option(min=0, help="Fall silent after so many frames.")] = None,
    frame_pool: Annotated[
        int, typer.Option(min=0, help="Serve so many frames again and again; 0 makes every frame anew.")
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
