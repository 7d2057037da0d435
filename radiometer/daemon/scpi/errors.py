"""SCPI error numbers (SCPI-99, volume 2, chapter 21) and how ours map to them."""

from __future__ import annotations

from typing import Final

from radiometer.daemon.journal import JournalError
from radiometer.daemon.scpi.formats import string
from radiometer.errors import (
    CalibrationError,
    DeviceError,
    DeviceTimeout,
    LightEnded,
    MeasurementError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)

MESSAGES: Final = {
    0: "No error",
    -101: "Invalid character",
    -102: "Syntax error",
    -103: "Invalid separator",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -112: "Program mnemonic too long",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -131: "Invalid suffix",
    -138: "Suffix not allowed",
    -141: "Invalid character data",
    -151: "Invalid string data",
    -161: "Invalid block data",
    -200: "Execution error",
    -213: "Init ignored",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -225: "Out of memory",
    -230: "Data corrupt or stale",
    -240: "Hardware error",
    -241: "Hardware missing",
    -250: "Mass storage error",
    -310: "System error",
    -340: "Calibration failed",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
    -365: "Time out error",
    -440: "Query UNTERMINATED after indefinite response",
}

# Bits of the standard event status register, by the hundred of the error number.
OPERATION_COMPLETE: Final = 1 << 0
_EVENT_BITS: Final = ((-499, -400, 1 << 2), (-399, -300, 1 << 3), (-299, -200, 1 << 4), (-199, -100, 1 << 5))
POWER_ON: Final = 1 << 7


class ScpiError(Exception):
    """An entry of the error queue.

    Args:
        detail: What exactly; follows the standard text after a semicolon.
    """

    def __init__(self, number: int, detail: str = "") -> None:
        self.number, self.detail = number, detail
        super().__init__(self.entry)

    @property
    def entry(self) -> str:
        """Return the reply to SYSTem:ERRor?, at most 255 characters in the quotes as the standard wants."""
        text = MESSAGES[self.number] + (f";{self.detail}" if self.detail else "")
        return f"{self.number},{string(text, longest=255)}"

    @property
    def event_bit(self) -> int:
        """Return the bit that the error sets in the standard event status register."""
        return next((bit for low, high, bit in _EVENT_BITS if low <= self.number <= high), 0)

    @property
    def is_command_error(self) -> bool:
        """Return whether the message itself is wrong, so that the rest of it is thrown away."""
        return -199 <= self.number <= -100


_MAPPING: Final[tuple[tuple[type[Exception], int], ...]] = (
    (SettingOutOfRange, -222),
    (UnsafeStimulus, -222),
    (LightEnded, -221),
    (JournalError, -250),
    (CalibrationError, -340),
    (MeasurementError, -200),
    (UsageError, -222),
    (DeviceTimeout, -365),
    (DeviceError, -240),
    (TimeoutError, -365),
)


def scpi_error(error: Exception) -> ScpiError:
    """Return the entry of the error queue for one of our own errors."""
    number = next((number for kind, number in _MAPPING if isinstance(error, kind)), -310)
    return ScpiError(number, str(error))
