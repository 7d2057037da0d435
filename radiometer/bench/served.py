"""Puts the simulated camera or light box of a bench, or the box's firmware, behind its real protocol."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.bench.box_holder import own_folder
from radiometer.bench.boxes import SIMULATED_PORTS, LightBoxConfig, exposure_store, read_preset
from radiometer.bench.cameras import SIMULATED, make_camera
from radiometer.bench.config import BenchConfig, SimulatedCameraConfig, read_bench
from radiometer.data.storage import read_yaml
from radiometer.errors import ConfigurationError, InputError, OutputError, OutputRefused, UsageError
from simulators.cameras.blackfly_awkward import SERIAL as AWKWARD_SERIAL
from simulators.cameras.blackfly_awkward import AwkwardBlackfly
from simulators.cameras.blackfly_gige import BlackflyGige, ForwardModelSource, PictureSource, PooledSource
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.light_box.avr_box import AvrBox
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.lines import LineFaults, PtyServer, WiredLightBox, was_left_behind
from simulators.observers.observer import Observer, ObserverAtBox, behaviour_of
from simulators.scenes.kinds import SCENES

_LOOK_S: Final = 0.05  # a tenth of the shortest period that anybody presses or resets a box with
_PRESS_S: Final = 0.2  # of a short press by a finger


def places_of(preset: LightBoxConfig) -> dict[str, tuple[float, float]]:
    """Return the places of the channels with separate openings, in degrees temporal of and above the mark."""
    known = preset.channels
    return {name: (c.place.temporal_deg, -c.place.below_deg) for name, c in known.items() if c.place is not None}


def seat_subject(twin: SimulatedLightBox, behaviour: str, seed: int, filter_density: float) -> ObserverAtBox:
    """Seat a simulated subject before a simulated box and return it.

    Args:
        behaviour: Name of a behaviour of `simulators.observers.observer`.
        filter_density: Optical density of the filter before the spot.

    Raises:
        UsageError: If the behaviour is unknown.
    """
    chosen, rng = behaviour_of(behaviour), np.random.default_rng(seed)
    subject = ObserverAtBox(
        Observer(chosen.eye(rng), chosen.habits, rng),
        twin,
        filter_density=filter_density,
        leaves_after_min=chosen.leaves_after_min,
        taps=chosen.taps,
    )
    subject.sit_down()
    return subject


@dataclass(frozen=True, slots=True)
class ServedBox:
    """A light box on a pseudo-terminal."""

    server: PtyServer  # serves it once started
    press: Callable[[bool], None]  # presses (True) or releases (False) the button now
    reset: Callable[[], None]  # restarts the box now


def served_box(
    serial: str,
    link: Path | None,
    *,
    firmware: Path | None = None,
    clock_ppm: float = 0.0,
    corrupt: float = 0.0,
    drop: float = 0.0,
    seed: int = 0,
    subject: str | None = None,
    filter_density: float = 0.0,
) -> ServedBox:
    """Return a simulated light box ready to be served.

    Args:
        link: Name of its port; in the folder where boxes are looked for where None.
        firmware: Run this firmware (Intel HEX) in simavr instead of the twin.
        corrupt: Probability that a byte on the line becomes another one.
        drop: Probability that a byte is lost.
        seed: Makes the faults, and the subject's answers.
        subject: Simulated subject before it, as `seat_subject` knows them; it sees and presses in real time.
        filter_density: Optical density of the filter before the spot.

    Raises:
        UsageError: If the serial number is not possible, or the subject: it is unknown, or is to sit before the
            firmware, whose LEDs are not simulated.
        OutputError: If the link cannot be made.
        OutputRefused: If a file, or a link of another program, is where the link is to be.
        MissingLibrary: If simavr is asked for and not installed.
        UnsafeStimulus: If the account of its exposure cannot be stored.
    """
    if not re.fullmatch(r"[0-9A-Za-z-]{8}", serial):
        raise UsageError(f"--serial {serial!r}: expected eight letters or digits, such as TWIN0001")
    place = link or own_folder(SIMULATED_PORTS) / serial
    if os.path.lexists(place) and not was_left_behind(place):
        raise OutputRefused(
            f"{place} exists already, and no simulated box that was killed left it; name another place with --link"
        )
    try:
        place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make {place.parent}: {error.strerror or error}") from error
    faults_in, faults_out = (LineFaults(corrupt, drop, rng=np.random.default_rng((seed, way))) for way in (0, 1))
    if firmware is not None and subject is not None:
        raise UsageError("a simulated subject sees the LEDs of the twin, not of the firmware: leave out one of them")
    store = exposure_store()
    with store.change() as account:
        account.begin(serial, store.holder)  # a box that is simulated from now on: no eye was before it
    if firmware is not None:
        avr = AvrBox(firmware, serial)
        server = PtyServer(avr, place, faults_in, faults_out)
        return ServedBox(server, _locked(server, lambda pressed: avr.press(pressed=pressed)), lambda: None)
    twin = SimulatedLightBox(SimulatedBoxSettings(serial=serial, clock_ppm=clock_ppm))
    if subject is not None:
        seat_subject(twin, subject, seed, filter_density).places = places_of(read_preset())
    server = PtyServer(WiredLightBox(twin), place, faults_in, faults_out)

    def reset() -> None:
        with server.lock:
            twin.reset("E")

    return ServedBox(server, _locked(server, lambda pressed: twin.press(server.time_s(), pressed=pressed)), reset)


def _locked(server: PtyServer, act: Callable[[bool], None]) -> Callable[[bool], None]:
    def press(pressed: bool) -> None:
        with server.lock:
            act(pressed)

    return press


def _no_visitor(seconds: float) -> bool:
    time.sleep(seconds)
    return False


def tend(
    made: ServedBox, reset_every_s: float | None, press_every_s: float | None, entered: Callable[[float], bool] | None
) -> None:
    """Press and reset a box as often as asked, in s, and press where somebody entered something, for ever."""
    start_s = time.monotonic()
    resets = presses = 0
    while True:
        if (entered or _no_visitor)(_LOOK_S):
            _press(made)
        elapsed_s = time.monotonic() - start_s
        if reset_every_s and elapsed_s > (resets + 1) * reset_every_s:
            resets += 1
            made.reset()
        if press_every_s and elapsed_s > (presses + 1) * press_every_s:
            presses += 1
            _press(made)


def _press(made: ServedBox) -> None:
    made.press(True)
    time.sleep(_PRESS_S)
    made.press(False)


_LOOK_AT_CAMERA_S = 0.02  # how late Ctrl-C may take effect
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
            sleep(_LOOK_AT_CAMERA_S)
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
