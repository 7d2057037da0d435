"""V4L2 devices through linuxpy; the only module that imports it."""

from __future__ import annotations

import errno
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from drivers.cameras.call_thread import CallThread
from drivers.cameras.v4l2_link import Control, VideoFrame
from radiometer.devices import CameraIdentity
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout, MissingLibrary

_LOOK_S: Final = 0.1  # whether the device file is there is asked this often: it goes at once when it is unplugged
_GONE: Final = {errno.ENODEV, errno.ENXIO, errno.EIO, errno.EPIPE}


def load_library() -> ModuleType:
    """Return linuxpy's video module. Raises MissingLibrary where it is not installed."""
    try:
        from linuxpy.video import device
    except ImportError as error:
        raise MissingLibrary("webcams need linuxpy: pip install 'radiometer[v4l2]'") from error
    module: ModuleType = device
    return module


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


class LinuxpyVideo:
    """Opens V4L2 devices."""

    def open(self, path: str) -> LinuxpyDevice:
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
