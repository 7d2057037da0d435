"""Aravis's GigE Vision device server in this process, through ctypes.

`libaravis` is called directly: through PyGObject the picture callback's closure is freed at once, because its
annotation says `scope="call"`, and the process dies.
"""

from __future__ import annotations

import ctypes
import socket
import struct
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from radiometer.errors import DeviceInUse, MissingLibrary

# void (*) (ArvBuffer *buffer, void *user_data, guint32 exposure_us, guint32 gain, ArvPixelFormat format)
_FILL_PATTERN: Final = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)
GVCP_PORT: Final = 3956  # GigE Vision's control port
_LIBRARIES: Final = ("libaravis-0.8.so.0", "libaravis-0.10.so.0")
_G_TYPE_DOUBLE: Final = 15 << 2  # gtype.h: fundamental types are shifted by two


class _GValue(ctypes.Structure):
    _fields_ = (("type", ctypes.c_size_t), ("payload", ctypes.c_uint64 * 2))


@lru_cache(maxsize=1)
def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    """Return Aravis and GObject. Raises MissingLibrary."""
    for name in _LIBRARIES:
        try:
            aravis = ctypes.CDLL(name)
            gobject = ctypes.CDLL("libgobject-2.0.so.0")
        except OSError:
            continue
        _declare(aravis, gobject)
        return aravis, gobject
    raise MissingLibrary("a simulated GigE Vision camera needs Aravis: apt install gir1.2-aravis-0.8 aravis-tools")


def _declare(aravis: ctypes.CDLL, gobject: ctypes.CDLL) -> None:
    pointer, text, word = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_uint32
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "arv_gv_fake_camera_new_full": (pointer, [text, text, text]),
        "arv_gv_fake_camera_is_running": (ctypes.c_int, [pointer]),
        "arv_gv_fake_camera_get_fake_camera": (pointer, [pointer]),
        "arv_fake_camera_read_memory": (ctypes.c_int, [pointer, word, word, pointer]),
        "arv_fake_camera_write_memory": (ctypes.c_int, [pointer, word, word, text]),
        "arv_fake_camera_set_fill_pattern": (None, [pointer, _FILL_PATTERN, pointer]),
        "arv_fake_camera_set_trigger_frequency": (None, [pointer, ctypes.c_double]),
        "arv_buffer_get_data": (pointer, [pointer, pointer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(aravis, name)
        function.restype, function.argtypes = result, arguments
    gobject.g_object_unref.restype, gobject.g_object_unref.argtypes = None, [pointer]
    gobject.g_object_set_property.restype = None
    gobject.g_object_set_property.argtypes = [pointer, text, ctypes.POINTER(_GValue)]


def _require_free(address: str) -> None:
    """Raise DeviceInUse unless a camera can listen at an address: the library itself does not report it."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.bind((address, GVCP_PORT))
    except OSError as error:
        raise DeviceInUse(
            f"no camera can be served at {address} port {GVCP_PORT} ({error.strerror or error}): another one is, "
            "or no network interface of this computer has that address"
        ) from error


class FakeGigeDevice:
    """Registers and pictures of a GigE Vision device that is served from this process until it is closed.

    Args:
        address: Address of a network interface of this computer to listen on, such as 127.0.0.1.
        serial: Serial number, at most 15 letters.

    Raises:
        MissingLibrary: If Aravis is not installed.
        DeviceInUse: If another camera is served at the address already, or it is not one of ours.
    """

    def __init__(self, address: str, serial: str, description: Path) -> None:
        self._aravis, self._gobject = _libraries()
        _require_free(address)
        self._server = self._aravis.arv_gv_fake_camera_new_full(
            address.encode(), serial.encode(), str(description).encode()
        )
        if not self._aravis.arv_gv_fake_camera_is_running(self._server):
            self._gobject.g_object_unref(self._server)
            raise DeviceInUse(f"no camera can be served at {address}: no network interface has that address")
        self._device = self._aravis.arv_gv_fake_camera_get_fake_camera(self._server)
        self._callback: Any = None

    @property
    def is_served(self) -> bool:
        """Tell whether it is on the network."""
        return self._server is not None

    def on_frame(self, payload: Callable[[], bytes]) -> None:
        """Ask `payload` for the bytes of every picture that is to be sent.

        It runs in the device's own thread; requests of the network wait meanwhile.
        """

        def fill(buffer: int, _data: int, _exposure: int, _gain: int, _format: int) -> None:
            content = payload()
            ctypes.memmove(self._aravis.arv_buffer_get_data(buffer, None), content, len(content))

        self._callback = _FILL_PATTERN(fill)  # kept: the library holds a bare pointer
        self._aravis.arv_fake_camera_set_fill_pattern(self._device, self._callback, None)

    def read_word(self, address: int) -> int:
        """Return a 32-bit register."""
        return int(struct.unpack(">I", self._read(address, 4))[0])

    def write_word(self, address: int, value: int) -> None:
        """Write a 32-bit register."""
        self._write(address, struct.pack(">I", value))

    def read_float(self, address: int) -> float:
        """Return a 64-bit floating-point register."""
        return float(struct.unpack(">d", self._read(address, 8))[0])

    def write_float(self, address: int, value: float) -> None:
        """Write a 64-bit floating-point register."""
        self._write(address, struct.pack(">d", value))

    def write_text(self, address: int, text: str, length: int) -> None:
        """Write a string register; what does not fit is cut off."""
        self._write(address, text.encode()[: length - 1].ljust(length, b"\0"))

    def lose_packets(self, ratio: float) -> None:
        """Drop each packet of a picture with a probability of 0 to 1."""
        value = _GValue(_G_TYPE_DOUBLE, (ctypes.c_uint64 * 2)(struct.unpack("=Q", struct.pack("=d", ratio))[0], 0))
        self._gobject.g_object_set_property(self._server, b"gvsp-lost-ratio", ctypes.byref(value))

    def set_trigger_rate_hz(self, rate_hz: float) -> None:
        """Look for a software trigger so many times per second."""
        self._aravis.arv_fake_camera_set_trigger_frequency(self._device, rate_hz)

    def close(self) -> None:
        """Leave the network; not to be called from `on_frame`'s thread."""
        server, self._server = self._server, None
        if server is not None:
            self._gobject.g_object_unref(server)  # joins the device's thread
            self._device = self._callback = None

    def _read(self, address: int, size: int) -> bytes:
        buffer = ctypes.create_string_buffer(size)
        self._aravis.arv_fake_camera_read_memory(self._device, address, size, buffer)
        return buffer.raw

    def _write(self, address: int, content: bytes) -> None:
        self._aravis.arv_fake_camera_write_memory(self._device, address, len(content), content)
