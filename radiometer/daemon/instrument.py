"""Interface that the daemon needs of an instrument; the bench provides it, tests provide a fake."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from radiometer.data import Frame, Patch, Reading, ResponseCurve
from radiometer.devices import CameraCapabilities, CameraIdentity

_CLIPPED_FRACTION: Final = 0.001  # hot pixels and glints are fewer


@dataclass(frozen=True, slots=True)
class MeasurementSettings:
    """What one measurement is made with."""

    patch: Patch | None = None  # where to read; None for the middle of the picture
    auto_exposure: bool = True  # whether exposures follow the scene
    exposure_s: float = 0.01  # exposure time in s where `auto_exposure` is false
    gain_db: float = 0.0  # analogue gain in dB
    # Wavelength of the source in nm where it is a line; None for the configured spectrum
    wavelength_nm: float | None = None

    @property
    def subject(self) -> tuple[Patch | None, float | None]:
        """Return what decides of what a reading is a reading: exposure and gain only decide how good it is."""
        return self.patch, self.wavelength_nm


@dataclass(frozen=True, slots=True)
class Origin:
    """What a measurement was made with and for whom."""

    settings: MeasurementSettings  # what it was made with
    sessions: tuple[str, ...] = ()  # the clients whose own measurement it is; empty where it belongs to all
    name: str = ""  # name of the patch; "" for the patch that is measured for all


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """How a device is doing."""

    temperature_c: float | None = None  # sensor or box temperature in °C; None where not reported
    counters: Mapping[str, int] = field(default_factory=dict)  # counts since it was opened, such as "missing_packets"
    # Levels of the light channels as the device itself has just reported them; None where it does not
    levels: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A reading and the frames it was made from."""

    reading: Reading  # the reading; its sequence number is given later, by the journal
    frames: tuple[Frame, ...] = ()  # the light frames that it was made from; perhaps none
    report: DeviceReport | None = None  # how the camera was doing after it; None where that is not known

    @property
    def frame(self) -> Frame | None:
        """Return the longest exposure that hardly clips, else the shortest; None where there are no frames."""
        by_exposure = sorted(self.frames, key=lambda frame: frame.settings.effective_exposure_s)
        for frame in reversed(by_exposure):
            if (frame.dn >= frame.saturated_dn).mean() < _CLIPPED_FRACTION:
                return frame
        return by_exposure[0] if by_exposure else None


class KeptDevice(Protocol):
    """What can be kept open: opened, asked whether it is there, closed; used from one thread at a time."""

    @property
    def late_at(self) -> float | None:
        """Return when the call in progress begins to be late (monotonic clock, s); None where that is not known."""

    def open(self) -> None:
        """Open the device, of a light box all channels dark. Raises DeviceError."""

    def close(self) -> None:
        """Release it, of a light box all channels dark; closing twice, or a lost device, does nothing."""

    def check(self) -> DeviceReport:
        """Ask whether it is there, of a camera without a frame; a box's dead-man timer is kept. Raises DeviceError."""


class ServedInstrument(KeptDevice, Protocol):
    """A camera with its calibration. Every call has a separate deadline."""

    @property
    def identity(self) -> CameraIdentity:
        """Return who the camera is; known before it is opened."""

    @property
    def limits(self) -> CameraCapabilities:
        """Return the camera's limits as of the last opening. Raises DeviceError before the first."""

    def measure(self, settings: MeasurementSettings) -> Measurement:
        """Take frames and return a reading. Raises DeviceError or MeasurementError."""

    def self_test(self) -> list[str]:
        """Return what is wrong, one sentence each; empty if nothing is. Raises DeviceError."""

    def reload_calibration(self) -> str:
        """Read the calibration file again and return one line that names it. Raises CalibrationError."""

    @property
    def response(self) -> ResponseCurve | None:
        """Return the response curve in use; None where the response is taken as linear."""

    @property
    def calibration_summary(self) -> Mapping[str, Any]:
        """Return where the calibration comes from: file, time, assumptions. Empty where uncalibrated."""


class LightSource(KeptDevice, Protocol):
    """A light box."""

    @property
    def name(self) -> str:
        """Return the name for messages."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Return the names of the channels; SCPI numbers them from 1."""

    def set_level(self, channel: str, level: float) -> float:
        """Set a channel's level, 0 to 1, and return it as read back. Raises DeviceError."""
