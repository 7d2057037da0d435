"""Raspberry Pi cameras through picamera2; the only module that imports it.

picamera2 needs the libcamera of Raspberry Pi OS (apt install python3-picamera2): a bare Debian 12 does not carry it.
"""

from __future__ import annotations

import re
from types import ModuleType
from typing import Any, Final

import numpy as np

from drivers.cameras.call_thread import CallThread
from drivers.cameras.pi_link import RawRequest, SensorMode
from radiometer.devices import CameraIdentity
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout, MissingLibrary

_LOOK_S: Final = 0.5  # how often a call that takes long is looked at


def load_library() -> ModuleType:
    """Return picamera2. Raises MissingLibrary where it, or the libcamera below it, is not installed."""
    try:
        import picamera2
    except ImportError as error:
        raise MissingLibrary(
            "the Raspberry Pi's camera needs picamera2: on Raspberry Pi OS `sudo apt install python3-picamera2`"
        ) from error
    module: ModuleType = picamera2
    return module


def listed_cameras() -> list[CameraIdentity]:
    """Return the Raspberry Pi cameras of this computer. Raises MissingLibrary."""
    return [
        CameraIdentity("Raspberry Pi", str(one["Model"]), "", f"picamera:{one['Num']}", "libcamera")
        for one in load_library().Picamera2.global_camera_info()
    ]


class PicameraLibrary:
    """Opens Raspberry Pi cameras."""

    def open(self, number: int) -> PicameraDevice:
        """Open a camera by its number. Raises DeviceNotFound, DeviceInUse, MissingLibrary."""
        library = load_library()
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
