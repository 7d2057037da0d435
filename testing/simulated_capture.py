"""Capture sets made by a camera model, for tests and benchmarks."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from radiometer.data import (
    CameraDescription,
    CaptureSet,
    CaptureSetWriter,
    Frame,
    FrameSettings,
    LensDescription,
    PatchDescription,
)
from simulators.chain.camera_model import CameraModel, VirtualSensor
from simulators.scenes.base import Scene


def simulate_capture(
    model: CameraModel,
    plan: Iterable[FrameSettings],
    scene: Scene,
    path: Path,
    *,
    width: int = 160,
    height: int = 120,
    frames_per_setting: int = 1,
    seed: int = 0,
    serial: str = "22500001",
    believed_camera: CameraDescription | None = None,
    believed_lens: LensDescription | None = None,
    patches: tuple[PatchDescription, ...] | None = None,
) -> CaptureSet:
    """Write the capture set that a camera model takes of a scene, and return it.

    The model may hold effects that the header does not state; the header states only what is believed.

    Args:
        plan: Settings in the order they are visited. A missing f-number, black level or timestamp is filled in from
            the lens, the camera and a clock that runs by exposure and readout.
        path: Folder to write; must not exist or be empty.
        width: Sensor width in pixels.
        height: Sensor height in pixels.
        frames_per_setting: Frames taken in a row at each setting.
        serial: Serial number; the fixed patterns follow from it.
        believed_camera: What the header says of the camera; by default the model's own description.
        believed_lens: What the header says of the lens; by default the model's own.
        patches: What the header says of the patches; by default the truth.

    Raises:
        OutputError: If the folder is not empty or cannot be written.
        ConfigurationError: If scene and plan do not fit.
        MeasurementError: If an effect fails; the message names it.
    """
    camera = believed_camera or model.camera
    sensor = VirtualSensor(model, scene, width, height, seed=seed, device_seed=zlib.crc32(serial.encode()))
    writer = CaptureSetWriter(
        path,
        camera.model_copy(update={"serial": camera.serial or serial}),
        believed_lens or model.lens,
        scene.source,
        scene.patches(width, height) if patches is None else patches,
        scene.patterns,
    )
    clock_s = 0.0
    with writer:
        for asked in plan:
            for index in range(frames_per_setting):
                settings = _completed(asked, model, clock_s)
                dn = sensor.expose(settings, frame_index=index)
                writer.add(Frame(dn, model.camera.bit_depth, settings))
                clock_s = (settings.timestamp_s or 0.0) + max(settings.exposure_s, 1 / 131)
        return writer.finish()


def _completed(settings: FrameSettings, model: CameraModel, clock_s: float) -> FrameSettings:
    return replace(
        settings,
        f_number=model.lens.f_number if settings.f_number is None else settings.f_number,
        black_level_dn=model.camera.black_level_dn if settings.black_level_dn is None else settings.black_level_dn,
        timestamp_s=max(clock_s, settings.timestamp_s or 0.0),
    )
