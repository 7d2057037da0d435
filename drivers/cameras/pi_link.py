"""The Raspberry Pi's camera in raw mode: the sensor's own numbers, each frame with the settings it was taken under.

picamera2 needs the libcamera of Raspberry Pi OS (apt install python3-picamera2): a bare Debian 12 does not carry it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.call_thread import CallThread
from drivers.cameras.plain_camera import FrameLink, Grab, bits_of
from radiometer.data.mosaic import plane_of
from radiometer.devices import CameraCapabilities, CameraIdentity, CameraSettings, Finding, Health
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout, required_library

MAX_STALE: Final = 12  # frames of the settings before: the camera stack queues several requests
_SAME_EXPOSURE_REL: Final = 0.02  # lines of the sensor: some tens of µs, coarse for the shortest exposures
_SAME_EXPOSURE_US: Final = 60.0  # two lines of 30 µs
_SAME_GAIN_REL: Final = 0.02  # analogue gains come in steps of 1 to 2 %
_FULL_SCALE_16: Final = 16  # bits in which the stack states black levels
_LOOK_S: Final = 0.5  # how often a call that takes long is looked at


@dataclass(frozen=True, slots=True)
class SensorMode:
    """A raw mode of the sensor: bits of a number, width and height in pixels, and its mosaic ("" for a grey sensor)."""

    bit_depth: int
    width: int
    height: int
    mosaic: str


@dataclass(frozen=True, slots=True, eq=False)
class RawRequest:
    """A raw frame, shape (height, width), right-aligned, with its metadata by the stack's names."""

    numbers: NDArray[np.uint16]
    metadata: dict[str, Any]


def load_library() -> Any:
    """Return picamera2. Raises MissingLibrary where it, or the libcamera below it, is not installed."""
    return required_library(
        "picamera2",
        "the Raspberry Pi's camera needs picamera2: on Raspberry Pi OS `sudo apt install python3-picamera2`",
    )


def listed_cameras() -> list[CameraIdentity]:
    """Return the Raspberry Pi cameras of this computer. Raises MissingLibrary."""
    return [
        CameraIdentity("Raspberry Pi", str(one["Model"]), "", f"picamera:{one['Num']}", "libcamera")
        for one in load_library().Picamera2.global_camera_info()
    ]


def open_device(place: str) -> PicameraDevice:
    """Open a camera by its number, 0 where none is named. Raises DeviceNotFound, DeviceInUse, MissingLibrary."""
    library, number = load_library(), int(place or 0)
    if number >= len(library.Picamera2.global_camera_info()):
        raise DeviceNotFound(f"there is no Raspberry Pi camera {number}; check its ribbon cable")
    try:
        return PicameraDevice(library.Picamera2(number), number)
    except RuntimeError as error:
        raise DeviceInUse(f"Raspberry Pi camera {number} is in use by another program ({error})") from error


class PicameraDevice:
    """An open Raspberry Pi camera.

    Args:
        camera: A `Picamera2`.
    """

    def __init__(self, camera: Any, number: int) -> None:
        self._camera, self._name, self._mode = camera, f"Raspberry Pi camera {number}", SensorMode(10, 0, 0, "")

    def modes(self) -> list[SensorMode]:
        """Return its raw modes."""
        found = []
        for mode in self._camera.sensor_modes:
            letters = re.match(r"S([RGB]{4})\d", str(mode["unpacked"]))
            width, height = mode["size"]
            found.append(SensorMode(int(mode["bit_depth"]), int(width), int(height), letters[1] if letters else ""))
        return found

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return lowest and highest value of its controls."""
        return {
            name: (float(low), float(high))
            for name, (low, high, *_) in self._camera.camera_controls.items()
            if name in ("ExposureTime", "AnalogueGain")
        }

    def start(self, mode: SensorMode, controls: dict[str, Any]) -> None:
        """Begin to capture in a raw mode. Raises DeviceError."""
        self._mode = mode
        letters = f"S{mode.mosaic}" if mode.mosaic else "R"
        raw = {"size": (mode.width, mode.height), "format": f"{letters}{mode.bit_depth}"}
        try:
            self._camera.configure(self._camera.create_still_configuration(raw=raw, buffer_count=2, controls=controls))
            self._camera.start()
        except RuntimeError as error:
            raise DeviceError(f"{self._name}: refused the raw mode ({error})") from error

    def request(self, deadline_s: float) -> RawRequest:
        """Return the next frame. Raises DeviceTimeout."""
        thread = CallThread(self._name, lambda: False, _LOOK_S, deadline_s)
        try:
            request = thread.run(self._camera.capture_request)
        except DeviceLost as error:
            raise DeviceTimeout(f"{self._name}: no frame within {deadline_s:.1f} s; check its ribbon cable") from error
        finally:
            thread.close()
        try:
            numbers = request.make_array("raw").view(np.uint16)[: self._mode.height, : self._mode.width]
            return RawRequest(numbers.copy(), dict(request.get_metadata()))
        finally:
            request.release()

    def stop(self) -> None:
        """End the capture."""
        self._camera.stop()

    def close(self) -> None:
        """Give the device back."""
        self._camera.close()


class PiLink(FrameLink[PicameraDevice]):
    """One Raspberry Pi camera in its deepest, largest raw mode; of a colour sensor the green pixels, at half size."""

    def __init__(self, identity: CameraIdentity, open_device: Callable[[str], PicameraDevice] = open_device) -> None:
        super().__init__(identity, open_device)
        self._mode = SensorMode(10, 0, 0, "")
        self._settings = CameraSettings(0.01, pixel_format="Mono10")
        self._black_dn = 0.0

    def _begin(self, device: PicameraDevice) -> CameraSettings:
        modes = device.modes()
        if not modes:
            raise DeviceError(f"{self._identity.device_id}: has no raw mode, so its numbers are not the sensor's")
        self._mode = max(modes, key=lambda mode: (mode.bit_depth, mode.width * mode.height))
        self._limits = self._read_limits(device, 0.0)
        shortest_s = self._limits.exposure_s[0]
        self.apply(CameraSettings(max(shortest_s, 0.001), pixel_format=f"Mono{self._mode.bit_depth}"))
        self.start()
        self._black_dn = self.grab().black_level_dn
        self.stop()
        self._limits = self._read_limits(device, self._black_dn)
        return self.apply(CameraSettings(0.01, pixel_format=f"Mono{self._mode.bit_depth}"))

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Take over exposure time and gain: they are set when the acquisition starts, and every frame states them."""
        self._settings = CameraSettings(
            settings.exposure_s, settings.gain_db, black_level_dn=self._black_dn, pixel_format=settings.pixel_format
        )
        return self._settings

    def start(self) -> None:
        """Begin to capture with manual exposure and gain, and a frame time that lets the exposure be."""
        exposure_us = round(self._settings.exposure_s * 1e6)
        controls = {
            "AeEnable": False,
            "AwbEnable": False,
            "ExposureTime": exposure_us,
            "AnalogueGain": 10 ** (self._settings.gain_db / 20),
            "FrameDurationLimits": (exposure_us, max(exposure_us, 33_333)),
        }
        self._open.start(self._mode, controls)

    def grab(self) -> Grab:
        deadline_s = 2 * self._settings.exposure_s + 3.0
        for _ in range(MAX_STALE):
            request = self._open.request(deadline_s)
            if self._is_current(request.metadata):
                return self._grabbed(request)
        raise DeviceTimeout(f"{self._identity.device_id}: keeps sending frames of other settings; close and reopen it")

    def stop(self) -> None:
        if self._device is not None:
            self._device.stop()

    def findings(self) -> list[Finding]:
        """Return what must be known: of a colour sensor one colour is read."""
        if not self._mode.mosaic:
            return []
        message = f"colour sensor ({self._mode.mosaic}): the green pixels of every 2 × 2 are read"
        return [Finding("mosaic", Health.NOTE, message)]

    def _read_limits(self, device: PicameraDevice, black_dn: float) -> CameraCapabilities:
        limits, step = device.limits(), 2 if self._mode.mosaic else 1
        (shortest_us, longest_us), (least, most) = limits["ExposureTime"], limits["AnalogueGain"]
        return CameraCapabilities(
            exposure_s=(max(shortest_us, 1.0) * 1e-6, longest_us * 1e-6),
            gain_db=(20 * math.log10(max(least, 1.0)), 20 * math.log10(most)),
            black_level_dn=(black_dn, black_dn),
            pixel_formats=(f"Mono{self._mode.bit_depth}",),
            width=self._mode.width // step,
            height=self._mode.height // step,
            has_temperature=True,
            exposure_step_s=1e-6,
        )

    def _is_current(self, metadata: dict[str, Any]) -> bool:
        set_us = self._settings.exposure_s * 1e6
        off_us = abs(float(metadata["ExposureTime"]) - set_us)
        gain = float(metadata["AnalogueGain"]) / 10 ** (self._settings.gain_db / 20)
        return off_us <= max(_SAME_EXPOSURE_US, _SAME_EXPOSURE_REL * set_us) and abs(gain - 1) <= _SAME_GAIN_REL

    def _grabbed(self, request: RawRequest) -> Grab:
        reported, bits = request.metadata, bits_of(self._settings.pixel_format)
        levels = reported.get("SensorBlackLevels") or (0,)
        temperature_c = reported.get("SensorTemperature")
        return Grab(
            dn=green_of(request.numbers, self._mode.mosaic),
            bit_depth=bits,
            exposure_s=float(reported["ExposureTime"]) * 1e-6,
            gain_db=round(20 * math.log10(float(reported["AnalogueGain"])), 6),
            black_level_dn=float(np.mean(levels)) / 2 ** (_FULL_SCALE_16 - bits),
            timestamp_s=float(reported["SensorTimestamp"]) * 1e-9,
            temperature_c=None if temperature_c is None else float(temperature_c),
        )


def green_of(numbers: NDArray[np.uint16], mosaic: str) -> NDArray[np.uint16]:
    """Return the first green pixel of every 2 × 2 of a mosaic, such as "RGGB"; a grey sensor's frame as it is."""
    return plane_of(numbers, mosaic, "green") if mosaic else numbers
