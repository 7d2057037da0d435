"""A V4L2 camera (a webcam): manual exposure by its controls, what bends its numbers switched off as far as it goes."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.cameras.call_thread import CallThread
from drivers.cameras.feature_access import FalsifyingFeature, HygieneFinding
from drivers.cameras.plain_camera import FrameLink, Grab, bits_of
from radiometer.data.frame import DigitalNumbers
from radiometer.devices import CameraCapabilities, CameraIdentity, CameraSettings, Finding, Health
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout, required_library

EXPOSURE_UNIT_S: Final = 1e-4  # V4L2_CID_EXPOSURE_ABSOLUTE counts 100 µs
_EXPOSURES: Final = ("exposure_time_absolute", "exposure_absolute", "exposure_time,_absolute")
# Formats of the video subsystem that hold plain numbers, best first, and what they become. Of YUYV it is the luma.
FORMATS: Final = {"Y16 ": "Mono16", "Y12 ": "Mono12", "Y10 ": "Mono10", "GREY": "Mono8", "YUYV": "Mono8"}
_STALE_AFTER_CHANGE: Final = 3  # frames: one exposed, one read out and one transferred when a control changes
_NO_AUTO, _BENT = "it drifts between frames", "digital numbers are no longer proportional to light"
# Control, harmless value (None: the device's own default), effect. The switches stand before what they govern.
CONTROLS: Final[tuple[tuple[str, int | None, str], ...]] = (
    ("auto_exposure", 1, f"exposure: {_NO_AUTO}"),
    ("exposure_auto", 1, f"exposure: {_NO_AUTO}"),
    ("exposure_dynamic_framerate", 0, f"exposure: {_NO_AUTO}"),
    ("exposure_auto_priority", 0, f"exposure: {_NO_AUTO}"),
    ("gain_automatic", 0, f"gain: {_NO_AUTO}"),
    ("white_balance_automatic", 0, "colour channels are scaled from frame to frame"),
    ("white_balance_temperature_auto", 0, "colour channels are scaled from frame to frame"),
    ("focus_automatic_continuous", 0, "the picture moves"),
    ("backlight_compensation", 0, _BENT),
    ("wide_dynamic_range", 0, _BENT),
    ("gamma", 100, _BENT),  # in hundredths
    ("sharpness", 0, "pixels depend on their neighbours"),
    ("brightness", None, "the black level is shifted"),
    ("contrast", None, _BENT),
    ("saturation", None, "colours are mixed"),
    ("power_line_frequency", 0, "the exposure time is bound to the mains"),
)
_LOOK_S: Final = 0.1  # whether the device file is there is asked this often: it goes at once when it is unplugged
_GONE: Final = {errno.ENODEV, errno.ENXIO, errno.EIO, errno.EPIPE}


@dataclass(frozen=True, slots=True)
class Control:
    """A control of a V4L2 device: its limits, step, default and value in its own unit."""

    minimum: int
    maximum: int
    step: int
    default: int
    value: int


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """A frame of a V4L2 device: bytes, and time of the kernel's steady clock in s."""

    payload: bytes
    timestamp_s: float


def load_library() -> Any:
    """Return linuxpy's video module. Raises MissingLibrary where it is not installed."""
    return required_library("linuxpy.video.device", "webcams need linuxpy: pip install 'radiometer[v4l2]'")


def listed_cameras() -> list[CameraIdentity]:
    """Return the V4L2 cameras of this computer. Raises MissingLibrary."""
    library, found = load_library(), []
    for device in library.iter_video_capture_devices():
        try:
            with device:
                info = device.info
                path = str(device.filename)
                found.append(CameraIdentity("", info.card, info.bus_info, f"v4l2:{path}", f"V4L2 {path}"))
        except OSError:  # held by another program, or not ours to open
            continue
    return found


def open_device(path: str) -> LinuxpyDevice:
    """Open a device. Raises DeviceNotFound, DeviceInUse, MissingLibrary."""
    library = load_library()
    if not Path(path).exists():
        raise DeviceNotFound(f"there is no {path}; `radiometer devices` lists the cameras that there are")
    device = library.Device(path)
    try:
        device.open()
    except OSError as error:
        raise _translated(error, path) from error
    return LinuxpyDevice(library, device, path)


class LinuxpyDevice:
    """An open V4L2 device.

    Args:
        library: linuxpy's video module.
        path: Where it is.
    """

    def __init__(self, library: Any, device: Any, path: str) -> None:
        self._library, self._device, self._path = library, device, path
        self._capture: Any = None

    def formats(self) -> list[tuple[str, int, int]]:
        """Return four-letter code, width and height of every format."""
        found = []
        for one in self._device.info.formats:
            code = _fourcc(one.pixel_format)
            for size in self._device.info.format_frame_sizes(one.pixel_format):
                width = getattr(size.info, "width", None) or size.info.max_width
                found.append((code, int(width), int(getattr(size.info, "height", None) or size.info.max_height)))
        return found

    def controls(self) -> dict[str, Control]:
        """Return its whole-number controls by name."""
        known = (self._library.BaseNumericControl, self._library.BooleanControl, self._library.MenuControl)
        return {
            one.config_name: Control(one.minimum, one.maximum, one.step or 1, int(one.default), int(one.value))
            for one in self._device.controls.values()
            if isinstance(one, known) and not one.is_flagged_write_only
        }

    def set_control(self, name: str, value: int) -> int:
        """Set a control and return it as read back. Raises DeviceError."""
        control = self._device.controls[name]
        try:
            control.value = value
            return int(control.value)
        except OSError as error:
            raise _translated(error, self._path) from error
        except (AttributeError, ValueError) as error:  # read-only, inactive or grabbed; not among its choices
            raise DeviceError(f"{self._path}: {error}") from error

    def start(self, fourcc: str, width: int, height: int) -> None:
        """Begin to stream. Raises DeviceInUse, DeviceError."""
        kind = self._library.BufferType.VIDEO_CAPTURE
        try:
            self._device.set_format(kind, width, height, fourcc)
            self._require_format(self._device.get_format(kind), fourcc, width, height)
            self._capture = self._library.VideoCapture(self._device)
            self._capture.open()
        except OSError as error:
            self._capture = None
            raise _translated(error, self._path) from error

    def _require_format(self, now: Any, fourcc: str, width: int, height: int) -> None:
        """Raise DeviceError where the device gives another format than was set, or rows with a margin."""
        given = f"{now.width} × {now.height} {_fourcc(now.pixel_format)}"
        if given != f"{width} × {height} {fourcc}":
            raise DeviceError(f"{self._path}: gives {given} where {width} × {height} {fourcc} was set; choose another")
        row = width * (1 if fourcc == "GREY" else 2)
        if now.bytes_per_line not in (0, row):
            raise DeviceError(
                f"{self._path}: rows of {given} take {now.bytes_per_line} bytes, not {row}; choose another"
            )

    def frame(self, deadline_s: float) -> VideoFrame:
        """Return the next frame. Raises DeviceTimeout, DeviceLost, or DeviceError where it does not stream."""
        if self._capture is None:
            raise DeviceError(f"{self._path} does not stream; start it first")
        thread = CallThread(self._path, lambda: not Path(self._path).exists(), _LOOK_S, deadline_s)
        try:
            frame = thread.run(self._capture.buffer.read)
        except OSError as error:
            raise _translated(error, self._path) from error
        except DeviceLost as error:
            if Path(self._path).exists():
                raise DeviceTimeout(f"{self._path}: no frame within {deadline_s:.1f} s, though it is there") from error
            raise
        finally:
            thread.close()
        return VideoFrame(bytes(frame.data), float(frame.timestamp))

    def stop(self) -> None:
        """End streaming."""
        capture, self._capture = self._capture, None
        if capture is not None and Path(self._path).exists():
            capture.close()

    def close(self) -> None:
        """Give the device back."""
        self.stop()
        self._device.close()


def _fourcc(pixel_format: int) -> str:
    """Return the four letters of a pixel format's number."""
    return int(pixel_format).to_bytes(4, "little").decode("ascii", "replace")


def _translated(error: OSError, path: str) -> DeviceError:
    reason = error.strerror or str(error)
    if error.errno == errno.EBUSY:
        return DeviceInUse(f"{path} is in use by another program ({reason}); close that program and try again")
    if error.errno in _GONE:
        return DeviceLost(f"{path} stopped answering ({reason}); check its cable, then open it again")
    if error.errno in (errno.ENOENT,):
        return DeviceNotFound(f"there is no {path}; `radiometer devices` lists the cameras that there are")
    if error.errno in (errno.EACCES, errno.EPERM):
        return DeviceError(f"{path} may not be opened ({reason}); join the group: sudo usermod -aG video $USER")
    return DeviceError(f"{path}: the camera refused ({reason})")


class V4l2Link(FrameLink[LinuxpyDevice]):
    """One V4L2 camera: manual exposure, its least gain, and no automatic function that can be switched off."""

    def __init__(self, identity: CameraIdentity, open_device: Callable[[str], LinuxpyDevice] = open_device) -> None:
        super().__init__(identity, open_device)
        self._codes: dict[str, str] = {}
        self._exposure_control, self._settings = "", CameraSettings(0.01, pixel_format="Mono8")
        self._hygiene: list[HygieneFinding] = []
        self._stale = 0

    def _begin(self, device: LinuxpyDevice) -> CameraSettings:
        self._hygiene = [*_switched_off(device)]
        self._limits = self._read_limits(device)
        return self.apply(CameraSettings(0.01, pixel_format=self._limits.pixel_formats[0]))

    def apply(self, settings: CameraSettings) -> CameraSettings:
        control_value = round(settings.exposure_s / EXPOSURE_UNIT_S)
        units = self._open.set_control(self._exposure_control, control_value)
        self._stale = _STALE_AFTER_CHANGE
        self._settings = CameraSettings(round(units * EXPOSURE_UNIT_S, 10), pixel_format=settings.pixel_format)
        return self._settings

    def start(self) -> None:
        limits = self.capabilities
        self._open.start(self._codes[self._settings.pixel_format], limits.width, limits.height)

    def grab(self) -> Grab:
        """Return the next frame; after a change of settings the first few are thrown away, for nothing marks them."""
        deadline_s = 2 * self._settings.exposure_s + 2.0
        while self._stale:
            self._open.frame(deadline_s)
            self._stale -= 1
        frame, limits = self._open.frame(deadline_s), self.capabilities
        code = self._codes[self._settings.pixel_format]
        dn = plain_numbers(frame.payload, code, limits.width, limits.height)
        bits = bits_of(self._settings.pixel_format)
        return Grab(dn, bits, self._settings.exposure_s, 0.0, 0.0, frame.timestamp_s or time.monotonic())

    def stop(self) -> None:
        if self._device is not None:
            self._device.stop()

    def findings(self) -> list[Finding]:
        """Return what still falsifies, what was switched off, and that a webcam's numbers follow a tone curve."""
        found = []
        for one in self._hygiene:
            check = f"control {one.feature.name}"
            if one.state == "still_on":
                found.append(
                    Finding(check, Health.WARNING, str(one), "recover the response with `radiometer response`")
                )
            elif one.state == "switched_off":
                found.append(Finding(check, Health.NOTE, str(one)))
        if bits_of(self._settings.pixel_format) == 8:
            message = "8-bit numbers of a webcam follow a tone curve (gamma) of its maker's, whatever its controls say"
            found.append(Finding("tone curve", Health.WARNING, message, "recover it with `radiometer response`"))
        return found

    def _read_limits(self, device: LinuxpyDevice) -> CameraCapabilities:
        offered = device.formats()
        sizes: dict[str, set[tuple[int, int]]] = {}
        for code, width, height in offered:
            if code in FORMATS and FORMATS[code] not in {FORMATS[c] for c in sizes if c != code}:
                sizes.setdefault(code, set()).add((width, height))
        if not sizes:
            codes = ", ".join(sorted({code for code, _, _ in offered})) or "none"
            raise DeviceError(f"{self._identity.device_id}: offers no plain numbers (only {codes}); use another camera")
        best = next(code for code in FORMATS if code in sizes)
        width, height = max(sizes[best], key=lambda size: size[0] * size[1])
        usable = [code for code in FORMATS if (width, height) in sizes.get(code, set())]
        self._codes = {FORMATS[code]: code for code in usable}
        controls = device.controls()
        self._exposure_control = next((name for name in _EXPOSURES if name in controls), "")
        if not self._exposure_control:
            raise DeviceError(
                f"{self._identity.device_id}: has no exposure control, so nothing can be measured with it"
            )
        exposure = controls[self._exposure_control]
        return CameraCapabilities(
            exposure_s=(max(exposure.minimum, 1) * EXPOSURE_UNIT_S, exposure.maximum * EXPOSURE_UNIT_S),
            gain_db=(0.0, 0.0),  # the control has no unit: it is left at its least
            black_level_dn=(0.0, 0.0),
            pixel_formats=tuple(self._codes),
            width=width,
            height=height,
            exposure_step_s=exposure.step * EXPOSURE_UNIT_S,
        )


def plain_numbers(payload: bytes, fourcc: str, width: int, height: int) -> DigitalNumbers:
    """Return the digital numbers of a frame, shape (height, width).

    Args:
        fourcc: Format, one of FORMATS: words are little-endian, of YUYV every other byte is a luma.
        width: Width in pixels.
        height: Height in pixels.

    Raises:
        DeviceError: If bytes are missing.

    Source: Linux media documentation, V4L2 image formats.
    """
    count = width * height
    size = 1 if fourcc == "GREY" else 2
    if len(payload) < count * size:
        raise DeviceError(
            f"a {width} × {height} {fourcc} frame takes {count * size} bytes, but only {len(payload)} came"
        )
    if fourcc in ("GREY", "YUYV"):
        return np.frombuffer(payload, np.uint8, count * size)[::size].reshape(height, width).copy()
    return np.frombuffer(payload, "<u2", count).astype(np.uint16).reshape(height, width)


def _switched_off(device: LinuxpyDevice) -> list[HygieneFinding]:
    found = []
    controls = device.controls()
    control_value = (
        (*CONTROLS, ("gain", controls["gain"].minimum, "gain: its control has no unit"))
        if "gain" in controls
        else CONTROLS
    )
    for name, harmless, effect in control_value:
        if name in controls:
            control = controls[name]
            value = (
                control.default
                if harmless is None
                else max(harmless, control.minimum)
                if name == "sharpness"
                else harmless
            )
            found.append(_set(device, FalsifyingFeature(name, value, effect), control))
    return found


def _set(device: LinuxpyDevice, feature: FalsifyingFeature, control: Control) -> HygieneFinding:
    harmless_value = int(feature.harmless)
    if control.value == harmless_value:
        return HygieneFinding(feature, control.value, control.value, "off")
    if not control.minimum <= harmless_value <= control.maximum:
        reason = f"it goes from {control.minimum} to {control.maximum}"
        return HygieneFinding(feature, control.value, control.value, "still_on", reason)
    try:
        now = device.set_control(feature.name, harmless_value)
    except DeviceLost:
        raise
    except DeviceError as error:
        return HygieneFinding(feature, control.value, control.value, "still_on", str(error))
    if now == harmless_value:
        return HygieneFinding(feature, control.value, now, "switched_off")
    return HygieneFinding(feature, control.value, now, "still_on", "it took the write and kept its value")
