"""Devices at the edge of a library: a webcam, a Raspberry Pi camera and a tethered camera, as libraries show them.

Nothing of V4L2, libcamera or libgphoto2 runs here: each object answers the calls that the driver makes of its library,
with pictures of the forward model.
"""

from __future__ import annotations

import io
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from drivers.cameras.pi_link import RawRequest, SensorMode
from drivers.cameras.v4l2_link import Control, VideoFrame
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost
from simulators.cameras.blackfly_gige import PictureRequest, PictureSource

_CONTROL_UNIT_S: Final = 1e-4
Mosaic = tuple[tuple[int, ...], ...]  # colours of its cell by row: 0 red, 1 green, 2 blue
RGGB: Final[Mosaic] = ((0, 1), (1, 2))


@dataclass(slots=True)
class _Edge:
    """What the three have in common: pictures, an owner, and a cable that can be pulled."""

    source: PictureSource
    width: int
    height: int
    is_open: bool = False
    is_unplugged: bool = False

    def take(self, what: str) -> None:
        """Open it for one program only."""
        self.require(what)
        if self.is_open:
            raise DeviceInUse(f"{what} is in use by another program")
        self.is_open = True

    def require(self, what: str) -> None:
        """Raise DeviceLost once the cable was pulled."""
        if self.is_unplugged:
            raise DeviceLost(f"{what} stopped answering")

    def picture(self, exposure_s: float, gain_db: float, black_dn: float, bits: int) -> NDArray[Any]:
        """Return a picture of the scene."""
        request = PictureRequest(
            exposure_s, gain_db, black_dn, bits, 40.0, 1.0, False, 1, 0, 0, self.width, self.height
        )
        return np.asarray(self.source(request))


def webcam_controls() -> dict[str, Control]:
    """Return the controls of a usual webcam, as it arrives: everything automatic."""
    return {
        "brightness": Control(-64, 64, 1, 0, 20),
        "contrast": Control(0, 64, 1, 32, 32),
        "white_balance_automatic": Control(0, 1, 1, 1, 1),
        "gamma": Control(72, 500, 1, 100, 150),
        "gain": Control(0, 100, 1, 0, 30),
        "power_line_frequency": Control(0, 2, 1, 1, 1),
        "sharpness": Control(0, 6, 1, 3, 3),
        "backlight_compensation": Control(0, 2, 1, 1, 1),
        "auto_exposure": Control(0, 3, 1, 3, 3),
        "exposure_time_absolute": Control(1, 20_000, 1, 157, 157),
        "exposure_dynamic_framerate": Control(0, 1, 1, 0, 1),
    }


@dataclass(slots=True)
class SimulatedWebcam(_Edge):
    """A webcam behind V4L2: one grey and one YUYV format, three frames in flight when a control changes."""

    values: dict[str, Control] = field(default_factory=webcam_controls)
    codes: tuple[str, ...] = ("GREY", "YUYV", "MJPG")
    locked: frozenset[str] = frozenset()
    in_flight: int = 3
    _code: str = ""
    _exposures: deque[int] = field(default_factory=deque)

    def open(self, path: str) -> SimulatedWebcam:
        """Open it."""
        self.take(path)
        return self

    def formats(self) -> list[tuple[str, int, int]]:
        """Return code, width and height of its formats; each at half size too."""
        return [(code, self.width // by, self.height // by) for code in self.codes for by in (2, 1)]

    def controls(self) -> dict[str, Control]:
        """Return its controls."""
        self.require("webcam")
        return dict(self.values)

    def set_control(self, name: str, value: int) -> int:
        """Set a control. Raises DeviceError for one that is locked."""
        self.require("webcam")
        known = self.values[name]
        if name in self.locked:
            raise DeviceError(f"{name} is inactive")
        value = min(max(value, known.minimum), known.maximum)
        self.values[name] = Control(known.minimum, known.maximum, known.step, known.default, value)
        return value

    def start(self, fourcc: str, _width: int, _height: int) -> None:
        """Begin to stream."""
        self.require("webcam")
        self._code = fourcc

    def frame(self, _deadline_s: float) -> VideoFrame:
        """Return the next frame, exposed under the control of some frames ago."""
        self.require("webcam")
        self._exposures.append(self.values["exposure_time_absolute"].value)
        while len(self._exposures) <= self.in_flight:
            self._exposures.appendleft(self._exposures[0])
        exposure_s = self._exposures.popleft() * _CONTROL_UNIT_S
        grey = self.picture(exposure_s, 0.0, 0.0, 8).astype(np.uint8)
        payload = grey.tobytes() if self._code == "GREY" else np.dstack([grey, np.full_like(grey, 128)]).tobytes()
        return VideoFrame(payload, time.monotonic())

    def stop(self) -> None:
        """End streaming."""
        self._code = ""

    def close(self) -> None:
        """Give it back."""
        self.is_open = False


@dataclass(slots=True)
class SimulatedPiCamera(_Edge):
    """A Raspberry Pi camera: a 12-bit mosaic, and two frames of the settings before when it is started."""

    black_16: float = 4096.0
    stale: int = 2
    _controls: dict[str, Any] = field(default_factory=dict)
    _in_flight: deque[tuple[float, float]] = field(default_factory=deque)

    def open(self, _place: str) -> SimulatedPiCamera:
        """Open it."""
        self.take("Raspberry Pi camera 0")
        return self

    def modes(self) -> list[SensorMode]:
        """Return a binned 10-bit mode and the full 12-bit one."""
        whole = (2 * self.width, 2 * self.height)
        return [SensorMode(10, self.width, self.height, "RGGB"), SensorMode(12, *whole, "RGGB")]

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return exposure limits in µs and gain limits as factors."""
        return {"ExposureTime": (31.0, 200e6), "AnalogueGain": (1.0, 16.0)}

    def start(self, _mode: SensorMode, controls: dict[str, Any]) -> None:
        """Begin to capture; frames of the settings before are still in flight."""
        self.require("Raspberry Pi camera 0")
        before = (self._controls.get("ExposureTime", 10_000), self._controls.get("AnalogueGain", 1.0))
        self._controls = dict(controls)
        self._in_flight = deque([before] * self.stale)

    def request(self, _deadline_s: float) -> RawRequest:
        """Return the next frame: the scene on the green pixels, half of it on the others."""
        self.require("Raspberry Pi camera 0")
        now = (self._controls["ExposureTime"], self._controls["AnalogueGain"])
        exposure_us, gain = self._in_flight.popleft() if self._in_flight else now
        black_dn = self.black_16 / 16
        green = self.picture(exposure_us * 1e-6, 20 * np.log10(gain), black_dn, 12)
        metadata = {
            "ExposureTime": exposure_us,
            "AnalogueGain": gain,
            "SensorBlackLevels": (self.black_16,) * 4,
            "SensorTemperature": 40.0,
            "SensorTimestamp": time.monotonic_ns(),
        }
        return RawRequest(mosaic_of(green, black_dn), metadata)

    def stop(self) -> None:
        """End the capture."""

    def close(self) -> None:
        """Give it back."""
        self.is_open = False


def dslr_settings() -> dict[str, tuple[str, list[str]]]:
    """Return value and choices of the settings of a usual camera, by the names that libgphoto2 gives them."""
    times = ["bulb", "30", "15", "8", "4", "2", "1", "0.5", "1/4", "1/8", "1/15", "1/30", "1/60", "1/125", "1/250"]
    return {
        "manufacturer": ("Canon Inc.", []),
        "serialnumber": ("042031001234", []),
        "autoexposuremode": ("AV", ["P", "TV", "AV", "Manual"]),
        "imageformat": ("Large Fine JPEG", ["Large Fine JPEG", "RAW", "RAW + Large Fine JPEG"]),
        "iso": ("Auto", ["Auto", "100", "200", "400", "800", "1600"]),
        "aperture": ("4", ["2.8", "4", "5.6", "8"]),
        "shutterspeed": ("1/60", [*times, "1/500", "1/1000", "1/2000", "1/4000"]),
    }


@dataclass(slots=True)
class SimulatedTether(_Edge):
    """A photographic camera on a cable: writes JPEG as it arrives, and a DNG with a Bayer mosaic once set to raw."""

    settings: dict[str, tuple[str, list[str]]] = field(default_factory=dslr_settings)
    black_dn: int = 512
    bits: int = 14
    seconds: Callable[[str], float] = field(default=lambda text: 2.0 ** round(np.log2(_plain(text))))
    releases: list[str] = field(default_factory=list)

    def open(self, port: str) -> SimulatedTether:
        """Open it."""
        self.take(f"camera at {port}")
        return self

    def names(self) -> frozenset[str]:
        """Return the names of its settings."""
        return frozenset(self.settings)

    def read(self, name: str) -> str:
        """Return a setting."""
        self.require("camera")
        return self.settings[name][0]

    def choices(self, name: str) -> list[str]:
        """Return what it can be set to."""
        return list(self.settings[name][1])

    def write(self, name: str, value: str) -> str:
        """Set it. Raises DeviceError for what is no choice."""
        self.require("camera")
        if value not in self.settings[name][1]:
            raise DeviceError(f"{name} has no choice {value}")
        self.settings[name] = (value, self.settings[name][1])
        return value

    def capture(self, _deadline_s: float) -> tuple[str, bytes]:
        """Release the shutter: the exact stop behind the dial's number, as real shutters aim at."""
        self.require("camera")
        shutter = self.settings["shutterspeed"][0]
        self.releases.append(shutter)
        if self.settings["imageformat"][0] != "RAW":
            return "IMG_0001.JPG", b"\xff\xd8\xff\xe1 developed"
        iso = self.settings["iso"][0]
        gain_db = 20 * np.log10(float(iso) / 100) if iso != "Auto" else 0.0
        green = self.picture(self.seconds(shutter), float(gain_db), self.black_dn, self.bits)
        return "IMG_0001.DNG", dng_bytes(mosaic_of(green, self.black_dn), self.black_dn, (1 << self.bits) - 1)

    def close(self) -> None:
        """Give it back."""
        self.is_open = False


def mosaic_of(green: NDArray[Any], black_dn: float) -> NDArray[np.uint16]:
    """Return an RGGB mosaic of twice the size: the picture on the green pixels, half of its light on red and blue."""
    height, width = green.shape
    mosaic = np.empty((2 * height, 2 * width), np.uint16)
    half = np.rint(black_dn + 0.5 * (green.astype(np.float64) - black_dn)).clip(0).astype(np.uint16)
    mosaic[0::2, 0::2] = mosaic[1::2, 1::2] = half
    mosaic[0::2, 1::2] = mosaic[1::2, 0::2] = green
    return mosaic


def dng_bytes(
    mosaic: NDArray[np.uint16], black_dn: int | tuple[int, ...], white_dn: int = 4095, pattern: Mosaic = RGGB
) -> bytes:
    """Return a bare DNG of a mosaic of 0 red, 1 green and 2 blue, with one black level or four of 2 × 2 pixels.

    Source: Adobe DNG 1.4, chapters 3 and 4.
    """
    matrix = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    codes = tuple(code for row in pattern for code in row)
    levels = black_dn if isinstance(black_dn, tuple) else (black_dn,)
    tags = [
        (33421, "H", 2, (len(pattern), len(pattern[0])), True),  # CFARepeatPatternDim
        (33422, "B", len(codes), codes, True),  # CFAPattern
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50708, "s", 0, "Simulated", True),  # UniqueCameraModel
        *([(50713, "H", 2, (2, 2), True)] if len(levels) == 4 else []),  # BlackLevelRepeatDim
        (50714, "H", len(levels), levels if len(levels) > 1 else levels[0], True),
        (50717, "I", 1, white_dn, True),
        (50721, "2i", 9, matrix, True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    stream = io.BytesIO()
    tifffile.imwrite(stream, mosaic, photometric=32803, extratags=tags)
    return stream.getvalue()


def _plain(text: str) -> float:
    above, _, below = text.partition("/")
    return float(above) / float(below or 1)
