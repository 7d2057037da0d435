"""A serial port as lines of bytes: every wait has a deadline, every failure a name.

The only module that imports `serial`.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import serial
import serial.tools.list_ports

from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound

LONGEST_LINE: Final = 512  # what comes without a line end for longer is not a line


class ReceivedLine(NamedTuple):
    """A line without its end, and when its end arrived on the line's clock, in s."""

    text: bytes
    time_s: float


class Received(Protocol):
    """A line without its end, and when its end arrived, as any line gives it."""

    @property
    def text(self) -> bytes:
        """Return the bytes."""

    @property
    def time_s(self) -> float:
        """Return when the line's end arrived, in s."""


class Line(Protocol):
    """Two-way lines of bytes, as the light box's driver needs them."""

    @property
    def name(self) -> str:
        """Return the port's name."""

    def open(self) -> None:
        """Open the port. Raises DeviceNotFound or DeviceInUse."""

    def close(self) -> None:
        """Release the port; closing twice does nothing."""

    def write(self, line: bytes) -> float:
        """Send bytes and return the time in s just before they left. Raises DeviceLost."""

    def read_line(self, timeout_s: float) -> Received | None:
        """Return the next line, or None where none is complete within `timeout_s`. Raises DeviceLost."""

    def now(self) -> float:
        """Return the time in s on the clock that stamps the lines."""


@dataclass(slots=True)
class SerialLine:
    """A serial port (or pseudo-terminal) through pyserial; 8 data bits, no parity, 1 stop bit."""

    port: str  # device file, such as /dev/ttyACM0
    baud_rate: int = 115200  # bits per second
    clock: Callable[[], float] = time.monotonic  # time in s for stamps and deadlines
    _serial: Any = None
    _buffer: bytes = b""

    @property
    def name(self) -> str:
        return self.port

    def now(self) -> float:
        return self.clock()

    def open(self) -> None:
        """Open the port for this program alone.

        Raises:
            DeviceNotFound: If there is no such port or it may not be opened.
            DeviceInUse: If another program holds it.
        """
        self._buffer = b""
        try:
            self._serial = serial.Serial(self.port, self.baud_rate, timeout=0, write_timeout=1.0, exclusive=True)
        except (serial.SerialException, OSError) as error:
            raise _opening_error(self.port, error) from error

    def close(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            port.close()

    def write(self, line: bytes) -> float:
        """Send bytes and return the time in s just before they left.

        Raises:
            DeviceLost: If the port has gone or takes nothing any more.
        """
        port = self._opened()
        started_s = self.clock()
        try:
            port.write(line)
        except (serial.SerialException, OSError, TypeError) as error:
            raise _lost(self.port, error) from error
        return started_s

    def read_line(self, timeout_s: float) -> ReceivedLine | None:
        deadline_s = self.clock() + timeout_s
        while True:
            line, end, rest = self._buffer.partition(b"\n")
            if end:
                self._buffer = rest
                return ReceivedLine(line, self.clock())
            remaining_s = deadline_s - self.clock()
            if remaining_s <= 0:
                return None
            self._buffer = (self._buffer + self._receive(remaining_s))[-LONGEST_LINE:]

    def _receive(self, timeout_s: float) -> bytes:
        port = self._opened()
        try:
            port.timeout = min(timeout_s, 0.1)
            return bytes(port.read(max(1, port.in_waiting)))
        except (serial.SerialException, OSError, TypeError) as error:
            # pyserial raises TypeError where another thread closed the port during a read
            raise _lost(self.port, error) from error

    def _opened(self) -> Any:
        if self._serial is None:
            raise DeviceError(f"{self.port} is not open; call open() first")
        return self._serial


class SerialPort(NamedTuple):
    """A serial port of this machine and what USB says of it: vendor and product (None where not USB), names, serial."""

    device: str
    vendor_id: int | None = None
    product_id: int | None = None
    names: str = ""
    usb_serial: str = ""


def list_serial_ports() -> list[SerialPort]:
    """Return the serial ports of this machine, by device file; none of them is opened."""
    found = serial.tools.list_ports.comports()
    return sorted(
        SerialPort(
            port.device,
            port.vid,
            port.pid,
            " ".join(filter(None, (port.manufacturer, port.product))),
            port.serial_number or "",
        )
        for port in found
    )


def _opening_error(port: str, error: Exception) -> DeviceError:
    number = getattr(error, "errno", None)
    reason = str(error)
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in reason or "busy" in reason:
        return DeviceInUse(f"{port} is held by another program; close it there first")
    if number == errno.EACCES or "Permission denied" in reason:
        return DeviceNotFound(
            f"{port} may not be opened by this user; add the user to the group that owns it (dialout)"
        )
    if not Path(port).exists():
        return DeviceNotFound(
            f"there is no port {port}; is the box plugged in? `radiometer devices` lists what answers"
        )
    return DeviceNotFound(f"{port} cannot be opened as a serial port: {reason}")


def _lost(port: str, error: Exception) -> DeviceLost:
    return DeviceLost(f"{port} has gone ({error}); plug the box in again and reopen it")
