"""Interface of every camera, real or simulated."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Protocol, Self, runtime_checkable

from radiometer.data import CameraDescription, Frame, LensDescription
from radiometer.errors import SettingOutOfRange


@dataclass(frozen=True, slots=True)
class Roi:
    """Region of interest on the sensor in pixels."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What can be set on a camera."""

    exposure_s: float  # exposure time in s
    gain_db: float = 0.0  # analogue gain in dB
    black_level_dn: float = 0.0  # black level in DN
    pixel_format: str = "Mono12"  # PFNC name, such as "Mono12"
    roi: Roi | None = None  # region of interest; None for the whole sensor
    binning: int = 1  # pixels summed in each direction
    software_trigger: bool = False  # expose on command rather than freely


@dataclass(frozen=True, slots=True)
class CameraCapabilities:
    """Limits of a camera, as it states them."""

    exposure_s: tuple[float, float]  # shortest and longest exposure time in s
    gain_db: tuple[float, float]  # lowest and highest gain in dB
    black_level_dn: tuple[float, float]  # lowest and highest black level in DN
    pixel_formats: tuple[str, ...]  # PFNC names on offer
    width: int  # sensor width in pixels
    height: int  # sensor height in pixels
    has_temperature: bool = False  # whether it reports a sensor temperature
    has_shutter: bool = False  # whether it can close itself for dark frames
    exposure_step_s: float = 0.0  # smallest step of the exposure time in s; 0 where unknown


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """Who a camera is: vendor, model, serial number, the id it is opened by, and how it is connected."""

    vendor: str
    model: str
    serial: str
    device_id: str
    interface: str = ""
    firmware: str = ""


@dataclass(frozen=True, slots=True)
class AcquisitionCounts:
    """What went wrong and was put right since the camera was opened."""

    frames: int = 0
    retried: int = 0
    incomplete: int = 0
    timeouts: int = 0
    underruns: int = 0
    resent_packets: int = 0
    missing_packets: int = 0
    extra: dict[str, int] = field(default_factory=dict)


@runtime_checkable
class Camera(Protocol):
    """A camera that gives raw digital numbers with the settings read back.

    Every wait has a deadline. What is out of range is refused with the value, the limits and the unit;
    nothing is clipped silently. A frame never mixes two settings.
    """

    @property
    def identity(self) -> CameraIdentity:
        """Return who the camera is; known before it is opened."""

    @property
    def capabilities(self) -> CameraCapabilities:
        """Return its limits. Raises DeviceError unless open."""

    @property
    def settings(self) -> CameraSettings:
        """Return the settings in force, as read back. Raises DeviceError unless open."""

    @property
    def description(self) -> CameraDescription:
        """Return what its datasheet or preset says of it."""

    @property
    def lens(self) -> LensDescription:
        """Return the lens in front of it, as configured."""

    @property
    def counts(self) -> AcquisitionCounts:
        """Return what went wrong and was put right since it was opened."""

    def open(self) -> None:
        """Open the device. Raises DeviceNotFound, DeviceInUse or MissingLibrary."""

    def close(self) -> None:
        """Release the device; closing twice does nothing."""

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set everything and return it as read back. Raises SettingOutOfRange; then nothing was changed."""

    def capture(self, count: int = 1) -> list[Frame]:
        """Return `count` complete frames exposed under the settings in force. Raises DeviceTimeout, DeviceLost."""

    def stream(self) -> Generator[Frame, None, None]:
        """Yield frames as they come until the iterator is closed."""

    def set_shutter(self, *, closed: bool) -> None:
        """Close or open the shutter. Raises DeviceError where `capabilities.has_shutter` is false."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


def refuse_roi_outside(device: str, roi: Roi, width: int, height: int) -> None:
    """Raise SettingOutOfRange where a region is not wholly on a sensor of `width` × `height` pixels."""
    for name, value, low, high in (
        ("ROI left", roi.x, 0, width - 1),
        ("ROI top", roi.y, 0, height - 1),
        ("ROI width", roi.width, 1, width - roi.x),
        ("ROI height", roi.height, 1, height - roi.y),
    ):
        if not low <= value <= high:
            raise SettingOutOfRange(device, name, value, low, high, "pixels")


def refuse_out_of_range(device: str, settings: CameraSettings, limits: CameraCapabilities) -> None:
    """Raise SettingOutOfRange for the first setting outside the camera's limits."""
    checks = (
        ("exposure time", settings.exposure_s, limits.exposure_s, "s"),
        ("gain", settings.gain_db, limits.gain_db, "dB"),
        ("black level", settings.black_level_dn, limits.black_level_dn, "DN"),
    )
    for name, value, (low, high), unit in checks:
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            raise SettingOutOfRange(device, name, value, low, high, unit)
