"""Photographic cameras through libgphoto2; the only module that imports its binding."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any, Final

from drivers.cameras.call_thread import CallThread
from radiometer.devices import CameraIdentity
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout, MissingLibrary

_LOOK_S: Final = 0.5  # how often a call that takes long is looked at
_SETTING_DEADLINE_S: Final = 15.0  # a camera that writes a raw file to its card answers late by seconds
# gphoto2-result.h and gphoto2-port-result.h.
_NOT_FOUND: Final = frozenset({-105, -52, -5, -4})  # MODEL_NOT_FOUND, IO_USB_FIND, UNKNOWN_PORT, LIBRARY
_IN_USE: Final = frozenset({-53, -60, -110})  # IO_USB_CLAIM, IO_LOCK, CAMERA_BUSY
_GONE: Final = frozenset({-7, -10, -34, -35})  # IO, TIMEOUT, IO_READ, IO_WRITE


def load_library() -> ModuleType:
    """Return the binding. Raises MissingLibrary where it is not installed."""
    try:
        import gphoto2
    except ImportError as error:
        raise MissingLibrary("photographic cameras need gphoto2: pip install 'radiometer[gphoto2]'") from error
    module: ModuleType = gphoto2
    return module


def listed_cameras() -> list[CameraIdentity]:
    """Return the photographic cameras on this computer's ports. Raises MissingLibrary."""
    found = load_library().Camera.autodetect()
    pairs = [(found.get_name(index), found.get_value(index)) for index in range(len(found))]
    return [CameraIdentity("", model, "", f"gphoto2:{port}", f"libgphoto2 {port}") for model, port in pairs]


class GphotoLibrary:
    """Opens photographic cameras."""

    def open(self, port: str) -> GphotoDevice:
        """Open the camera at a port; the only one where none is named.

        Raises:
            DeviceNotFound: If no camera answers there.
            DeviceInUse: If another program holds it.
            MissingLibrary: If libgphoto2's binding is not installed.
        """
        library = load_library()
        name = f"camera gphoto2:{port}"
        camera = library.Camera()
        try:
            if port:
                ports = library.PortInfoList()
                ports.load()
                camera.set_port_info(ports[ports.lookup_path(port)])
            camera.init()
        except library.GPhoto2Error as error:
            raise _translated(error, name) from error
        return GphotoDevice(library, camera, name)


class GphotoDevice:
    """An open photographic camera."""

    def __init__(self, library: Any, camera: Any, name: str) -> None:
        self._library, self._camera, self._name = library, camera, name
        self._due = 0.0
        self._names: frozenset[str] | None = None
        self._thread = CallThread(name, lambda: time.monotonic() > self._due, _LOOK_S)

    def names(self) -> frozenset[str]:
        """Return the names of its settings."""
        # The whole tree: the library's flat list names what a maker's cameras may have, not what this one has.
        if self._names is None:
            self._names = frozenset(_leaves(self._call(self._camera.get_config)))
        return self._names

    def read(self, name: str) -> str:
        """Return a setting. Raises DeviceLost."""
        return str(self._call(self._camera.get_single_config, name).get_value())

    def choices(self, name: str) -> list[str]:
        """Return what a setting can be set to; empty where it is not chosen from a list."""
        widget = self._call(self._camera.get_single_config, name)
        if widget.get_type() not in (self._library.GP_WIDGET_RADIO, self._library.GP_WIDGET_MENU):
            return []
        return [str(entry) for entry in widget.get_choices()]

    def write(self, name: str, value: str) -> str:
        """Set it and return it as read back. Raises DeviceError, DeviceLost."""
        widget = self._call(self._camera.get_single_config, name)
        widget.set_value(value)
        self._call(self._camera.set_single_config, name, widget)
        return self.read(name)

    def capture(self, deadline_s: float) -> tuple[str, bytes]:
        """Release the shutter and return name and bytes of the file. Raises DeviceTimeout, DeviceLost."""
        kind, part = self._library.GP_CAPTURE_IMAGE, self._library.GP_FILE_TYPE_NORMAL
        path = self._call(self._camera.capture, kind, deadline_s=deadline_s)
        file = self._call(self._camera.file_get, path.folder, path.name, part, deadline_s=deadline_s)
        return str(path.name), bytes(memoryview(file.get_data_and_size()))

    def close(self) -> None:
        """Give the camera back; one that is gone needs no goodbye."""
        try:
            self._call(self._camera.exit)
        except DeviceError:
            return
        finally:
            self._thread.close()

    def _call(self, method: Any, *arguments: Any, deadline_s: float = _SETTING_DEADLINE_S) -> Any:
        self._due = time.monotonic() + deadline_s
        try:
            return self._thread.run(method, *arguments)
        except self._library.GPhoto2Error as error:
            raise _translated(error, self._name) from error
        except DeviceLost as error:
            raise DeviceTimeout(f"{self._name}: no answer within {deadline_s:g} s; switch it off and on") from error


def _leaves(widget: Any) -> Iterator[str]:
    """Yield the names of the settings below a part of the tree."""
    parts = list(widget.get_children())
    if not parts:
        yield str(widget.get_name())
    for part in parts:
        yield from _leaves(part)


def _translated(error: Any, name: str) -> DeviceError:
    """Return the project's error for one of the library's."""
    code, text = int(error.code), str(error.string)
    if code in _NOT_FOUND:
        return DeviceNotFound(f"{name} does not answer ({text}); is it on, and its cable in? See `radiometer devices`")
    if code in _IN_USE:
        return DeviceInUse(f"{name} is in use by another program ({text}); file managers take cameras: eject it there")
    if code in _GONE:
        return DeviceLost(f"{name} stopped answering ({text}); check its cable and battery, then open it again")
    return DeviceError(f"{name}: the camera refused ({text})")
