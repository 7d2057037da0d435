"""The bench as the daemon's instrument: opens, reopens, measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from radiometer.analysis.calibration.shared import require_camera
from radiometer.analysis.photometry.photometry import spectrum
from radiometer.bench.assembly import calibration_path, stated_source, states_spectrum
from radiometer.bench.cameras import open_camera
from radiometer.bench.config import BenchConfig, read_bench
from radiometer.bench.instrument import Instrument, central_patch
from radiometer.daemon.instrument import DeviceReport, Measurement, MeasurementSettings
from radiometer.daemon.watched_camera import WatchedCamera
from radiometer.data import Bracket, Calibration, Frame, Patch, ResponseCurve
from radiometer.devices import Camera, CameraCapabilities, CameraIdentity
from radiometer.errors import DeviceError

_UNKNOWN = CameraIdentity("", "camera not seen yet", "", "")
_FIXED_REPEATS = 2  # one repeat, so that flicker between two equal frames can be noticed


class BenchInstrument:
    """The camera and calibration of a bench file.

    Args:
        bench: Bench file; the simulated bench where None.
        camera_name: "sim", or a GenICam id, serial number or address; the bench's own camera where None.
        calibration: Calibration file; the bench's own where None.
        spectrum_name: Spectrum assumed for the luminance; the bench's, else the calibration's, where None.

    Raises:
        ConfigurationError: If the bench file is wrong.
        CalibrationError: If the calibration cannot be used.
    """

    def __init__(
        self,
        bench: Path | None = None,
        camera_name: str | None = None,
        calibration: Path | None = None,
        *,
        uncalibrated: bool = False,
        spectrum_name: str | None = None,
    ) -> None:
        self._config, self._where = read_bench(bench, camera_name)
        self._name = camera_name
        self._path = None if uncalibrated else calibration or calibration_path(self._config, bench)
        self._spectrum = spectrum_name or self._config.spectrum
        self._calibration = self._read_calibration()
        self._camera: WatchedCamera | None = None
        self._limits: CameraCapabilities | None = None
        self._identity = _UNKNOWN
        self._temperature_c: float | None = None

    @property
    def config(self) -> BenchConfig:
        """Return the bench file."""
        return self._config

    @property
    def identity(self) -> CameraIdentity:
        """Return who the camera is; empty before it was first seen."""
        return self._identity

    @property
    def limits(self) -> CameraCapabilities:
        """Return the camera's limits as of the last opening. Raises DeviceError before the first."""
        if self._limits is None:
            raise DeviceError("the camera has not been open yet, so its limits are not known")
        return self._limits

    @property
    def late_at(self) -> float | None:
        """Return when the camera's call in progress begins to be late, on the monotonic clock; None without one."""
        camera = self._camera
        return camera.late_at if camera else None

    def open(self) -> None:
        """Open the camera, and refuse it where the calibration belongs to another. Raises DeviceError."""
        self.close()
        camera = WatchedCamera(open_camera(self._config, self._where, self._name))
        self._camera, self._identity, self._limits = camera, camera.identity, camera.capabilities

    def close(self) -> None:
        """Release the camera."""
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def check(self) -> DeviceReport:
        """Ask the camera for its settings, as a sign of life. Raises DeviceError."""
        camera = self._opened()
        _ = camera.settings
        counts = camera.counts
        named = {name: getattr(counts, name) for name in counts.__slots__ if name != "extra"}
        return DeviceReport(self._temperature_c, {**named, **counts.extra})

    def measure(self, settings: MeasurementSettings) -> Measurement:
        """Take a bracket, or frames of a fixed exposure, and return the reading of the patch."""
        camera = self._opened()
        camera.take_doubts()
        instrument = self._instrument(camera, settings)
        if camera.settings.gain_db != settings.gain_db:
            camera.configure(replace(camera.settings, gain_db=settings.gain_db))
        bracket = instrument.take_bracket() if settings.auto_exposure else self._fixed(camera, settings.exposure_s)
        temperatures = [f.settings.temperature_c for f in bracket.light if f.settings.temperature_c is not None]
        self._temperature_c = temperatures[-1] if temperatures else self._temperature_c
        reading = instrument.read(bracket)
        reading = replace(reading, flags=tuple(sorted({*reading.flags, *camera.take_doubts()})))
        return Measurement(reading, _distinct(bracket), self.check())

    def self_test(self) -> list[str]:
        """Take one of the shortest frames and look whether it is plausible. Raises DeviceError."""
        camera = self._opened()
        before = camera.settings
        camera.configure(replace(before, exposure_s=camera.capabilities.exposure_s[0]))
        frame = camera.capture(1)[0]
        camera.configure(before)
        faults = []
        if frame.dn.min() == frame.dn.max():
            faults.append(f"every pixel reads {frame.dn.min()} DN at the shortest exposure: no noise, no signal")
        black = before.black_level_dn
        if black and float(frame.dn.min()) > 2 * black:
            faults.append(f"the darkest pixel reads {frame.dn.min()} DN where the black level is {black:g} DN")
        return faults

    def reload_calibration(self) -> str:
        """Read the calibration file again and return one line that names it. Raises CalibrationError."""
        fresh = self._read_calibration()
        if fresh is not None and self._camera is not None:
            require_camera(fresh, self._camera.description)
        self._calibration = fresh
        return f"{self._path.name}, made {fresh.created}" if self._path and fresh else "no calibration in use"

    @property
    def response(self) -> ResponseCurve | None:
        """Return the response curve in use."""
        return self._calibration.response if self._calibration else None

    @property
    def calibration_summary(self) -> Mapping[str, Any]:
        """Return where the calibration comes from; empty where uncalibrated."""
        if self._calibration is None or self._path is None:
            return {}
        assumptions = list(self._calibration.provenance.assumptions)
        return {"source": self._path.name, "created": self._calibration.created, "assumptions": assumptions}

    def default_patch(self) -> Patch | None:
        """Return the patch that the bench file names; None for the middle of the frame."""
        return self._config.patch.patch if self._config.patch else None

    def _opened(self) -> WatchedCamera:
        if self._camera is None:
            raise DeviceError("the camera is not open")
        return self._camera

    def _read_calibration(self) -> Calibration | None:
        if self._path is None:
            return None
        calibration = Calibration.read(self._path)
        return replace(calibration, spectrum=self._spectrum) if self._spectrum else calibration

    def _instrument(self, camera: Camera, settings: MeasurementSettings) -> Instrument:
        calibration = self._calibration
        if calibration is not None and settings.wavelength_nm is not None:
            line = f"line:{settings.wavelength_nm:g}"
            spectrum(line)  # refuses a wavelength that has no meaning before any frame is taken
            calibration = replace(calibration, spectrum=line)
        patch = settings.patch or central_patch(camera)
        return Instrument(
            camera,
            patch,
            calibration=calibration,
            time_limit_s=self._config.time_limit_s,
            source=stated_source(self._config),
            spectrum_stated=settings.wavelength_nm is not None or states_spectrum(self._config, self._spectrum),
        )

    def _fixed(self, camera: Camera, exposure_s: float) -> Bracket:
        camera.configure(replace(camera.settings, exposure_s=exposure_s))
        frames: list[Frame] = camera.capture(_FIXED_REPEATS)
        return Bracket.from_frames(frames, origin=camera.identity.device_id)


def _distinct(bracket: Bracket) -> tuple[Frame, ...]:
    """Return one frame per exposure: what a picture needs."""
    return tuple({frame.settings.effective_exposure_s: frame for frame in bracket.light}.values())
