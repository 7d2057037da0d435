"""Cameras by name: "sim" for the simulated one of a bench file, else a GenICam id, serial number or address."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from radiometer.bench.config import SIMULATED as SIMULATED
from radiometer.bench.config import BenchConfig, CameraConfig, GenicamCameraConfig, SimulatedCameraConfig
from radiometer.data import CameraDescription
from radiometer.data.storage import shipped_config
from radiometer.devices import Camera, CameraCapabilities, CameraIdentity, CameraPreset, CameraSettings
from radiometer.errors import ConfigurationError, MissingLibrary

_NEAREST_FORMATS = (
    "Mono12", "Mono12p", "Mono12Packed", "Mono14", "Mono16", "Mono10", "Mono10p", "Mono8",
    *(f"Bayer{start}{bits}" for bits in ("12", "12p", "12Packed", "8") for start in ("RG", "GR", "GB", "BG")),
)  # fmt: skip
OWN_KINDS = ("v4l2", "picamera", "gphoto2")  # asked of the drivers only where one of them is named


def open_camera(config: BenchConfig, where: Path, name: str | None = None) -> Camera:
    """Return an opened camera with gain, black level and pixel format set as the bench file wants them.

    Args:
        where: The bench file, for messages and relative paths.
        name: "sim", or a GenICam id, serial number or address; None for the bench's own camera.

    Raises:
        ConfigurationError: If the bench has no such camera.
        DeviceError: If it cannot be opened or set.
    """
    camera = make_camera(config, where, name)
    camera.open()
    camera_config = config.camera
    try:
        camera.configure(_first_settings(camera_config, camera.capabilities))
    except BaseException:
        camera.close()
        raise
    return camera


def make_camera(config: BenchConfig, where: Path, name: str | None = None) -> Camera:
    """Return the camera of a name without opening it.

    Raises:
        ConfigurationError: If "sim" is asked of a bench without a simulated camera.
    """
    camera_config = config.camera
    if name == SIMULATED or (name is None and isinstance(camera_config, SimulatedCameraConfig)):
        if not isinstance(camera_config, SimulatedCameraConfig):
            raise ConfigurationError(f"{where}: its camera is {camera_config.kind}, so there is no 'sim'")
        return _simulated(config, camera_config, where)
    return _real(config, name)


def list_cameras(config: BenchConfig, where: Path) -> tuple[list[CameraIdentity], str | None]:
    """Return the cameras that can be opened, and why GenICam cameras could not be looked for (None if they could)."""
    from drivers.cameras.own_cameras import listed

    found: list[CameraIdentity] = []
    if isinstance(config.camera, SimulatedCameraConfig):
        found.append(make_camera(config, where).identity)
    owned = listed()[0]  # `radiometer doctor` reports a library that is not installed
    try:
        from drivers.cameras.aravis_camera import discover

        return found + discover() + owned, None
    except MissingLibrary as error:
        return found + owned, str(error)


def _real(config: BenchConfig, name: str | None) -> Camera:
    own = config.camera if isinstance(config.camera, GenicamCameraConfig) else None
    camera_id = name or (own.id if own else None)
    if name is None and own and own.kind != "genicam":
        camera_id = f"{own.kind}:{(own.id or '').removeprefix(f'{own.kind}:')}"
    if camera_id is not None and camera_id.partition(":")[0] in OWN_KINDS and ":" in camera_id:
        from drivers.cameras.own_cameras import open_own

        preset = CameraPreset.shipped(own.preset).camera if own and own.preset else None
        return open_own(camera_id, config.lens_description, preset)
    from drivers.cameras.aravis_camera import open_camera as find

    return find(camera_id, preset=own.preset if own else None, lens=config.lens_description)


def _first_settings(camera_config: CameraConfig, limits: CameraCapabilities) -> CameraSettings:
    """Return what a bench wants of a camera, in the nearest pixel format that it offers."""
    low, high = limits.black_level_dn
    order = (camera_config.pixel_format, *_NEAREST_FORMATS)
    return CameraSettings(
        exposure_s=max(0.01, limits.exposure_s[0]),
        gain_db=camera_config.gain_db,
        black_level_dn=low if low == high else camera_config.black_level_dn,  # no black level to set on such a camera
        pixel_format=next((name for name in order if name in limits.pixel_formats), camera_config.pixel_format),
    )


def _simulated(config: BenchConfig, camera_config: SimulatedCameraConfig, where: Path) -> Camera:
    from simulators.cameras.simulated_camera import ColourFilters, SimulatedCamera
    from simulators.chain.camera_model import CameraModel
    from simulators.scenes import scene_from_mapping
    from simulators.scenes.base import PulsedLight

    if config.scene is None:
        raise ConfigurationError(f"{where}: key 'scene' is missing; a simulated camera needs something to look at")
    datasheet, limits = simulated_parts(camera_config, where)
    model = (
        CameraModel.read(where.parent / camera_config.model)
        if camera_config.model
        else CameraModel.ideal(datasheet, config.lens_description)
    )
    flicker = camera_config.flicker
    pulsed = PulsedLight(flicker.frequency_Hz, flicker.modulation, flicker.duty) if flicker else None
    return SimulatedCamera(
        model,
        scene_from_mapping(config.scene, f"{where}: scene", where.parent),
        seed=camera_config.seed,
        serial=camera_config.serial,
        device_id=SIMULATED,
        limits=limits,
        filters=ColourFilters() if limits.pixel_formats[0].startswith("Bayer") else None,
        temperature_c=camera_config.temperature_C,
        modulation=pulsed,
    )


def simulated_parts(camera_config: SimulatedCameraConfig, where: Path) -> tuple[CameraDescription, CameraCapabilities]:
    """Return what the datasheet says of a simulated camera, and its limits, with a shutter.

    The preset is a file next to the bench file, or one that comes with the product.

    Raises:
        ConfigurationError: If there is no such preset, or it is damaged.
    """
    name = camera_config.preset
    own_file = where.parent / "cameras" / f"{name}.yaml"
    file = own_file if own_file.is_file() else shipped_config(f"cameras/{name}.yaml")
    preset = CameraPreset.read(file)
    limits = preset.require_limits(str(file)).capabilities(has_shutter=True)
    width, height = camera_config.width or limits.width, camera_config.height or limits.height
    return preset.camera, replace(limits, width=width, height=height)
