"""Puts the simulated camera of a bench behind the GigE Vision protocol."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from radiometer.bench.cameras import SIMULATED, make_camera
from radiometer.bench.config import BenchConfig, SimulatedCameraConfig, read_bench
from radiometer.data.storage import read_yaml
from radiometer.errors import ConfigurationError, InputError
from simulators.cameras.blackfly_awkward import SERIAL as AWKWARD_SERIAL
from simulators.cameras.blackfly_awkward import AwkwardBlackfly
from simulators.cameras.blackfly_gige import BlackflyGige, ForwardModelSource, PictureSource, PooledSource
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.scenes.kinds import SCENES

_LOOK_S = 0.02  # how late Ctrl-C may take effect
_PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".hdr", ".exr", ".npy")


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong with a served camera."""

    lose_per_mille: int = 0  # packets lost of a thousand
    answer_delay_s: float = 0.0  # time by which frames and answers are late, in s
    stall_after: int | None = None  # frames after which it sends no more; None for never
    drop_after: int | None = None  # frames after which it falls silent; None for never


def served_camera(
    bench: Path | None = None,
    scene: str | None = None,
    *,
    serial: str | None = None,
    address: str = "127.0.0.1",
    seed: int | None = None,
    real_time: bool = True,
    pool: int = 0,
    awkward: bool = False,
) -> BlackflyGige:
    """Return the simulated camera of a bench, ready to be served.

    Args:
        bench: Bench file; the simulated bench where None.
        scene: YAML file of a scene, or of a bench whose scene is taken; a picture; or the name of a kind of scene.
            The bench's own where None.
        serial: Serial number; the bench's where None.
        seed: Makes the noise; the bench's where None.
        pool: Frames served again and again; 0 makes every frame anew.
        awkward: Serve one that is as awkward as a real Blackfly, with a new serial number where none is given.

    Raises:
        ConfigurationError: If the bench has no simulated camera, or a file holds something not allowed.
    """
    config, where = read_bench(bench)
    camera_config = config.camera
    if not isinstance(camera_config, SimulatedCameraConfig):
        raise ConfigurationError(f"{where}: its camera is {camera_config.kind}; only a simulated one can be served")
    changed = {"serial": serial or camera_config.serial, "seed": camera_config.seed if seed is None else seed}
    config = config.model_copy(update={"camera": camera_config.model_copy(update=changed)})
    if scene is not None:
        mapping, where = _scene_of(scene)
        config = config.model_copy(update={"scene": mapping})
    camera = _simulated(config, where)
    with camera:
        limits = replace(camera.capabilities, has_shutter=False)
    source: PictureSource = ForwardModelSource(camera.sensor)
    source = PooledSource(source, pool) if pool else source
    if awkward:
        return AwkwardBlackfly(
            source,
            limits,
            serial=serial or AWKWARD_SERIAL,
            address=address,
            temperature_c=camera_config.temperature_C,
            real_time=real_time,
        )
    return BlackflyGige(
        source,
        limits,
        vendor=camera.identity.vendor,
        model=camera.identity.model,
        serial=camera.identity.serial,
        address=address,
        native_bit_depth=camera.model.camera.bit_depth,
        temperature_c=camera_config.temperature_C,
        real_time=real_time,
    )


def serve(camera: BlackflyGige, faults: Faults, sleep: Callable[[float], None] = time.sleep) -> None:
    """Keep a camera served until Ctrl-C, a termination signal, or its disconnection."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    camera.lose_packets(faults.lose_per_mille)
    camera.answer_slowly(faults.answer_delay_s)
    try:
        while camera.is_served:
            if faults.drop_after is not None and camera.frames_sent >= faults.drop_after:
                camera.disconnect()
            elif faults.stall_after is not None and camera.frames_sent >= faults.stall_after:
                camera.stall(stalled=True)
            sleep(_LOOK_S)
    except KeyboardInterrupt:
        return


def _scene_of(named: str) -> tuple[dict[str, Any], Path]:
    """Return a scene's mapping, and the file or folder that its messages and relative paths are about."""
    file = Path(named)
    if named in SCENES and not file.exists():
        return {"kind": named}, Path(f"--scene {named}")
    if file.suffix.lower() in _PICTURES:
        return {"kind": "image", "file": str(file.resolve())}, file
    try:
        mapping = read_yaml(file)
    except InputError as error:
        raise ConfigurationError(
            f"{error}; a scene is a YAML file, a picture, or one of {', '.join(SCENES)}"
        ) from error
    scene = mapping.get("scene", mapping)
    if not isinstance(scene, dict):
        raise ConfigurationError(f"{file}: key 'scene' must hold keys and values")
    return scene, file


def _simulated(config: BenchConfig, where: Path) -> SimulatedCamera:
    camera = make_camera(config, where, SIMULATED)
    if not isinstance(camera, SimulatedCamera):
        raise ConfigurationError(f"{where}: only a simulated camera can be served")
    return camera
