"""Reads and writes GenICam features, and raises the library's errors as the project's errors."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final, TypeVar

from drivers.cameras.call_thread import CallThread
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost

_Result = TypeVar("_Result")
FeatureValue = bool | int | float | str

# ArvDeviceError codes of Aravis 0.8 (arvdevice.h) that mean "it no longer answers".
_NO_ANSWER: Final = frozenset({2, 4, 5})  # NOT_CONNECTED, TRANSFER_ERROR, TIMEOUT
_NOT_CONTROLLER: Final = frozenset({10, 17, 18})  # NOT_CONTROLLER, PROTOCOL_ERROR_ACCESS_DENIED, _BUSY


class Refusal(DeviceError):
    """The camera answers, but does not do what it was asked for."""


class FeatureAccess:
    """Features of one open camera.

    Args:
        camera: An `Aravis.Camera`.
        library_error: The exception class of the library, `GLib.Error`.
        thread: Where calls run that may wait for the camera; None to run them where they are asked for.

    Attributes:
        lost: Set once the camera did not answer, so that no call waits for it again.
    """

    def __init__(
        self, camera: Any, name: str, library_error: type[Exception], thread: CallThread | None = None
    ) -> None:
        self.lost = threading.Event()
        self._camera = camera
        self._thread = thread
        self._name = name
        self._library_error = library_error

    def call(self, method: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return `method(*arguments)`, which may wait for the camera.

        Raises:
            DeviceLost: If the camera did not answer.
            DeviceInUse: If another program controls it.
            DeviceError: For anything else that the library reports.
        """
        if self._thread is None:
            return self.call_here(method, *arguments)
        try:
            return self._thread.run(method, *arguments)
        except self._library_error as error:
            raise self._noted(error) from error
        except DeviceLost:
            self.lost.set()
            raise

    def call_here(self, method: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return `method(*arguments)`, which needs nothing from the camera. Raises what `call` raises."""
        try:
            return method(*arguments)
        except self._library_error as error:
            # No local name for it: an exception that its own frame holds keeps the camera alive as garbage.
            raise self._noted(error) from error

    def close(self) -> None:
        """Let the thread of the calls end."""
        if self._thread is not None:
            self._thread.close()

    def _noted(self, error: Exception) -> DeviceError:
        """Return the project's error, having taken note of a camera that is gone."""
        translated_error = translated(error, self._name)
        if isinstance(translated_error, DeviceLost):
            self.lost.set()
        return translated_error

    def has(self, feature: str) -> bool:
        """Tell whether a feature exists and can be used now."""
        return bool(self.call(self._camera.is_feature_available, feature))

    def read(self, feature: str, kind: type[FeatureValue]) -> FeatureValue:
        """Return the value of a feature, read from the camera as bool, int, float or str."""
        reader = {
            bool: self._camera.get_boolean,
            int: self._camera.get_integer,
            float: self._camera.get_float,
            str: self._camera.get_string,
        }[kind]
        return kind(self.call(reader, feature))

    def write(self, feature: str, value: FeatureValue) -> FeatureValue:
        """Write a feature and return it as read back."""
        writer = {
            bool: self._camera.set_boolean,
            int: self._camera.set_integer,
            float: self._camera.set_float,
            str: self._camera.set_string,
        }[type(value)]
        self.call(writer, feature, value)
        return self.read(feature, type(value))

    def read_if_there(self, feature: str, kind: type[FeatureValue]) -> FeatureValue | None:
        """Return the value of a feature; None where the camera has none of that name."""
        return self.read(feature, kind) if self.has(feature) else None

    def execute(self, command: str) -> None:
        """Execute a command feature."""
        self.call(self._camera.execute_command, command)

    def unit(self, feature: str) -> str:
        """Return the unit that the camera's description states for a feature, "" where it states none."""
        node = self._camera.get_device().get_feature(feature)
        return str(node.get_unit() or "") if hasattr(node, "get_unit") else ""


def translated(error: Exception, name: str) -> DeviceError:
    """Return the project's error for one of the library's.

    Args:
        error: A `GLib.Error`.
    """
    code, domain = getattr(error, "code", None), getattr(error, "domain", "")
    text = getattr(error, "message", str(error))
    if domain == "arv-device-error-quark" and code in _NO_ANSWER:
        return DeviceLost(f"{name} stopped answering ({text}); check its cable and power, then open it again")
    if "busy" in text.lower() or (domain == "arv-device-error-quark" and code in _NOT_CONTROLLER):
        return DeviceInUse(f"{name} is in use by another program ({text}); close that program and try again")
    return Refusal(f"{name}: the camera refused ({text}); `radiometer doctor` shows what it offers")
