"""Opens what a command needs from a bench file, and closes it again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from radiometer.bench.cameras import open_camera
from radiometer.bench.config import BenchConfig, SimulatedCameraConfig, read_bench
from radiometer.bench.instrument import Instrument, central_patch
from radiometer.data import Calibration, Patch, PatchDescription, SourceDescription
from radiometer.data.storage import shipped_config
from radiometer.devices import Camera
from radiometer.errors import CalibrationError, ConfigurationError, UsageError


@contextmanager
def open_bench_camera(bench: Path | None, name: str | None) -> Iterator[tuple[BenchConfig, Camera]]:
    """Open the camera of a bench file for the block.

    Args:
        bench: Bench file; the simulated bench where None.
        name: "sim", or a GenICam id, serial number or address; the bench's own camera where None.

    Raises:
        ConfigurationError: If the bench file is wrong.
        DeviceError: If the camera cannot be opened.
    """
    config, where = read_bench(bench, name)
    camera = open_camera(config, where, name)
    try:
        yield config, camera
    finally:
        camera.close()


@contextmanager
def open_instrument(
    bench: Path | None = None,
    name: str | None = None,
    patch: Patch | None = None,
    calibration: Path | None = None,
    *,
    uncalibrated: bool = False,
    spectrum: str | None = None,
    f_number: float | None = None,
) -> Iterator[Instrument]:
    """Open camera and calibration of a bench file for the block.

    Args:
        bench: Bench file; the simulated bench where None.
        name: "sim", or a GenICam id, serial number or address; the bench's own camera where None.
        patch: Where to read; the bench's, else the middle of the frame, where None.
        calibration: Calibration file; the bench's own where None.
        spectrum: Spectrum assumed for the luminance; the bench's, else the calibration's, where None.
        f_number: f-number that a real lens is set to; the bench's where None.

    Raises:
        RadiometerError: If anything named cannot be used.
    """
    with open_bench_camera(bench, name) as (config, camera):
        chosen = None if uncalibrated else calibration or calibration_path(config, bench)
        where = patch or (config.patch.patch if config.patch else central_patch(camera))
        yield Instrument(
            camera,
            where,
            calibration=_calibration(chosen, spectrum or config.spectrum) if chosen else None,
            time_limit_s=config.time_limit_s,
            f_number=_set_by_hand(config, f_number),
            source=stated_source(config),
            spectrum_stated=bool(spectrum or config.spectrum),
            calibration_file=chosen,
        )


def stated_source(config: BenchConfig) -> SourceDescription | None:
    """Return what a bench file says of the light; None where it says nothing. Simulated light is a line at 550 nm."""
    if isinstance(config.camera, SimulatedCameraConfig) and config.source.wavelength_nm is None:
        from simulators.chain.camera_model import DEFAULT_WAVELENGTH_NM

        return config.source.model_copy(update={"wavelength_nm": DEFAULT_WAVELENGTH_NM})
    return config.source if "source" in config.model_fields_set else None


def _set_by_hand(config: BenchConfig, f_number: float | None) -> float | None:
    """Return the f-number stated by hand; a simulated lens is what its bench says."""
    if f_number is None:
        return None
    if f_number <= 0:
        raise UsageError(f"--f-number {f_number:g}: must be above 0")
    own = config.lens.f_number if config.lens and isinstance(config.camera, SimulatedCameraConfig) else f_number
    if abs(f_number / own - 1.0) > 1e-9:
        raise UsageError(f"--f-number {f_number:g}: the simulated lens is at f/{own:g}; change its bench file")
    return f_number


def _calibration(path: Path, spectrum: str | None) -> Calibration:
    calibration = Calibration.read(path)
    return replace(calibration, spectrum=spectrum) if spectrum else calibration


def require_absolute(calibration: Calibration | None) -> Calibration:
    """Return a calibration with an absolute scale.

    Raises:
        CalibrationError: If there is none: what is read is then no radiance.
    """
    if calibration is None or not calibration.absolute:
        raise CalibrationError(
            "the camera has no absolute calibration, so it cannot measure a radiance; make one with "
            "`radiometer calibrate`, then name it in the bench file (calibration:) or as the camera's calibration"
        )
    return calibration


def calibration_path(config: BenchConfig, bench: Path | None) -> Path | None:
    """Return the calibration file that a bench names: relative to the bench file, else one that is shipped.

    Raises:
        ConfigurationError: If it names one that does not exist.
    """
    if config.calibration is None:
        return None
    calibration_file = (bench.parent if bench else Path()) / config.calibration
    if bench and calibration_file.is_file():
        return calibration_file
    try:
        return shipped_config(config.calibration)
    except ConfigurationError as error:
        raise ConfigurationError(
            f"{bench or 'the simulated bench'}: calibration {config.calibration!r}: {error}"
        ) from error


def known_patches(config: BenchConfig) -> tuple[PatchDescription, ...]:
    """Return the regions that a bench knows of; the radiance of the one to be measured is left open."""
    if config.patches or config.patch is None:
        return config.patches
    return (PatchDescription(name="patch", **config.patch.model_dump()),)
