"""A camera that one library hands whole frames of: regions, counts and life cycle, whatever the library is.

Webcams, the Raspberry Pi's camera and tethered photographic cameras differ in how they are set and read (a `FrameLink`
each); what the `Camera` protocol asks beyond that stands here once.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from radiometer.data import CameraDescription, Frame, FrameSettings, LensDescription
from radiometer.data.frame import CameraFile, DigitalNumbers
from radiometer.data.white_level import WhiteLevel
from radiometer.devices import (
    AcquisitionCounts,
    CameraCapabilities,
    CameraIdentity,
    CameraSettings,
    Finding,
    Roi,
    refuse_out_of_range,
    refuse_roi_outside,
)
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, SettingOutOfRange

_Result = TypeVar("_Result")
_held: set[str] = set()  # devices opened by this process: some libraries let one process open a camera twice
_held_lock = threading.Lock()


class NamedCamera(Opened):
    """What every driver of a camera has: a name for messages, one opening per process, and the form of a block."""

    @property
    @abstractmethod
    def identity(self) -> CameraIdentity:
        """Return who the camera is."""

    @property
    def _label(self) -> str:
        who = self.identity
        return "camera " + (" ".join(part for part in (who.vendor, who.model, who.serial) if part) or who.device_id)

    def _hold(self, open_device: Callable[[], _Result]) -> _Result:
        """Return what opening the device gives. Raises DeviceInUse where this process holds it already."""
        name = self.identity.device_id
        with _held_lock:
            if name in _held:
                raise DeviceInUse(f"{self._label} is in use by this program already; close it there first")
            _held.add(name)
        try:
            return open_device()
        except BaseException:
            _held.discard(name)
            raise


def let_go(device_id: str) -> None:
    """Let this process open a device again."""
    _held.discard(device_id)


@dataclass(frozen=True, slots=True, eq=False)
class Grab:
    """A whole frame as the library gave it."""

    dn: DigitalNumbers  # digital numbers, right-aligned, shape (height, width)
    bit_depth: int  # bits of a digital number
    exposure_s: float  # exposure time that it was taken with in s
    gain_db: float  # gain that it was taken with in dB
    black_level_dn: float  # its black level in DN
    timestamp_s: float  # time of a steady clock in s
    temperature_c: float | None = None  # sensor temperature in °C; None where unknown
    f_number: float | None = None  # f-number as the camera states it; None where it does not
    file: CameraFile | None = None  # the raw file that the numbers were read from, where the camera wrote one
    # Digital number from which the camera says that pixels are saturated; None where it does not
    white_level_dn: float | None = None


class LinkedDevice(Protocol):
    """An open device of any library."""

    def close(self) -> None:
        """Give it back."""


_Device = TypeVar("_Device", bound=LinkedDevice)


class FrameLink(ABC, Generic[_Device]):
    """How one library's camera is opened, set and read.

    Args:
        identity: Who it is; its `device_id` is the name of the library, a colon, and its place.
        open_device: Opens the device at a place. Raises DeviceNotFound, DeviceInUse, MissingLibrary.
    """

    def __init__(self, identity: CameraIdentity, open_device: Callable[[str], _Device]) -> None:
        self._identity, self._open_device = identity, open_device
        self._device: _Device | None = None
        self._limits: CameraCapabilities | None = None

    @property
    def identity(self) -> CameraIdentity:
        """Return who the camera is."""
        return self._identity

    @property
    def capabilities(self) -> CameraCapabilities:
        """Return its limits. Raises DeviceError unless open."""
        if self._limits is None:
            raise DeviceError(f"{self._identity.device_id} is not open; call open() first")
        return self._limits

    def open(self) -> CameraSettings:
        """Take the device and return the settings in force. Raises DeviceError."""
        self._device = self._open_device(self._identity.device_id.partition(":")[2])
        try:
            return self._begin(self._device)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Give the device back, whatever its state."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    @abstractmethod
    def _begin(self, device: _Device) -> CameraSettings:
        """Prepare a device that was just opened, learn its limits, and return the settings in force."""

    @abstractmethod
    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set exposure, gain and format, and return them as read back. Raises DeviceError."""

    @abstractmethod
    def start(self) -> None:
        """Begin an acquisition: frames grabbed from now on are exposed from now on. Raises DeviceError."""

    @abstractmethod
    def grab(self) -> Grab:
        """Return the next frame exposed under the settings in force. Raises DeviceTimeout, DeviceLost."""

    @abstractmethod
    def stop(self) -> None:
        """End the acquisition."""

    @abstractmethod
    def findings(self) -> list[Finding]:
        """Return what was found of the camera that a user must know."""

    @property
    def _open(self) -> _Device:
        if self._device is None:
            raise DeviceLost(f"{self._identity.device_id} is not open; open it again")
        return self._device


class PlainCamera(NamedCamera):
    """A camera behind a `FrameLink`, as a `Camera`.

    Args:
        link: The library's camera.
        preset: What its datasheet says; None where nothing is known.
    """

    def __init__(
        self, link: FrameLink[Any], lens: LensDescription | None = None, preset: CameraDescription | None = None
    ) -> None:
        self._link, self._lens, self._preset = link, lens or LensDescription(), preset
        self._settings: CameraSettings | None = None
        self._lost = False
        self._frames = 0
        self._stated_f_number: float | None = None

    @property
    def identity(self) -> CameraIdentity:
        return self._link.identity

    @property
    def capabilities(self) -> CameraCapabilities:
        self._require_open()
        return self._link.capabilities

    @property
    def settings(self) -> CameraSettings:
        return self._require_open()

    @property
    def description(self) -> CameraDescription:
        """Return what its preset says, in the digital numbers of the pixel format in force."""
        settings, who = self._settings, self.identity
        base = self._preset or CameraDescription(bit_depth=8)
        known: dict[str, object] = {
            "vendor": who.vendor or None,
            "model": who.model or None,
            "serial": who.serial or None,
        }
        if settings is not None:
            limits = self._link.capabilities
            known |= {"bit_depth": bits_of(settings.pixel_format), "black_level_dn": settings.black_level_dn}
            # Such cameras do not say how they bin, but pictures of another size have other pixels.
            known |= {"mode": base.mode or f"{limits.width} × {limits.height} pixels"}
        return base.model_copy(update=known)

    @property
    def lens(self) -> LensDescription:
        """Return the lens in front of it, as configured; the f-number is the camera's where nothing else states it."""
        stated = self._stated_f_number
        if self._lens.f_number is None and stated is not None:
            return self._lens.model_copy(update={"f_number": stated})
        return self._lens

    @property
    def counts(self) -> AcquisitionCounts:
        """Return how many frames came since it was opened."""
        return AcquisitionCounts(frames=self._frames)

    def findings(self) -> list[Finding]:
        """Return what a user must know of it. Raises DeviceError unless open."""
        self._require_open()
        return self._link.findings()

    def open(self) -> None:
        """Take the device and switch off what falsifies radiometry, as far as it can be.

        Raises:
            DeviceNotFound: If nothing answers to its name.
            DeviceInUse: If another program, or this one, holds it.
            MissingLibrary: If the library is not installed.
        """
        if self._settings is not None:
            raise DeviceInUse(f"{self._label} is open already; close it first")
        self._settings = self._hold(self._link.open)
        self._lost, self._frames = False, 0

    def close(self) -> None:
        if self._settings is None:
            return
        self._settings = None
        let_go(self.identity.device_id)
        self._link.close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self._require_open()
        self._check(settings)
        in_force = self._noted(lambda: self._link.apply(settings))
        limits = self._link.capabilities
        whole = Roi(0, 0, limits.width, limits.height)
        roi = None if settings.roi == whole else settings.roi
        self._settings = replace(in_force, roi=roi, software_trigger=settings.software_trigger)
        return self._settings

    def capture(self, count: int = 1) -> list[Frame]:
        self._require_open()
        self._noted(self._link.start)
        try:
            return [self._next() for _ in range(count)]
        finally:
            self._link.stop()

    def stream(self) -> Generator[Frame, None, None]:
        self._require_open()
        self._noted(self._link.start)
        try:
            while self._settings is not None:
                yield self._next()
        finally:
            self._link.stop()

    def set_shutter(self, *, closed: bool) -> None:
        """Refuse: none of these can keep its shutter closed for a dark frame. Raises DeviceError."""
        raise DeviceError(f"{self._label}: has no shutter to close; cover the lens by hand for dark frames")

    def _require_open(self) -> CameraSettings:
        if self._settings is None:
            raise DeviceError(f"{self._label} is not open; call open() first")
        if self._lost:
            raise DeviceLost(f"{self._label} stopped answering; check its cable and power, then open it again")
        return self._settings

    def _noted(self, call: Callable[[], _Result]) -> _Result:
        try:
            return call()
        except DeviceLost:
            self._lost = True
            raise

    def _next(self) -> Frame:
        settings = self._require_open()
        grab = self._noted(self._link.grab)
        self._frames += 1
        self._stated_f_number = grab.f_number or self._stated_f_number
        roi = settings.roi
        dn = grab.dn if roi is None else grab.dn[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width]
        return Frame(
            dn=dn,
            bit_depth=grab.bit_depth,
            settings=FrameSettings(
                exposure_s=grab.exposure_s,
                gain_db=grab.gain_db,
                f_number=self.lens.f_number,
                black_level_dn=grab.black_level_dn,
                temperature_c=grab.temperature_c,
                timestamp_s=grab.timestamp_s,
                white_level=None if grab.white_level_dn is None else WhiteLevel.stated(grab.white_level_dn),
            ),
            frame_id=self._frames,
            file=grab.file if roi is None else None,  # a region is not what the file holds
        )

    def _check(self, settings: CameraSettings) -> None:
        limits = self._link.capabilities
        if settings.pixel_format not in limits.pixel_formats:
            raise DeviceError(
                f"{self._label}: pixel format {settings.pixel_format} is not offered; "
                f"choose one of {', '.join(limits.pixel_formats)}"
            )
        refuse_out_of_range(self._label, settings, limits)
        if settings.binning != 1:
            raise SettingOutOfRange(self._label, "binning", settings.binning, 1, 1, "pixels")
        if settings.roi is not None:
            refuse_roi_outside(self._label, settings.roi, limits.width, limits.height)


def bits_of(pixel_format: str) -> int:
    """Return the bits of a digital number of a monochrome format, such as 14 of "Mono14"."""
    return int(pixel_format.removeprefix("Mono"))
