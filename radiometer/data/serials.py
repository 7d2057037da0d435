"""Serial numbers that one side writes in decimal and the other in hexadecimal.

A USB3 camera of FLIR carries its number in its USB descriptor as eight hexadecimal digits (`0138C343`); its label, its
GigE twin and people write the same number in decimal (`20497219`).
"""

from __future__ import annotations

import re
from typing import Final

_HEXADECIMAL: Final = re.compile(r"[0-9A-Fa-f]{8}")
_PLAINLY_HEXADECIMAL: Final = re.compile(r"(?=.*[A-Fa-f]|0)[0-9A-Fa-f]{8}")  # a letter, or filled up with zeros


def same_serial(one: str, other: str) -> bool:
    """Return whether two serial numbers are the same, whichever of them is written in hexadecimal."""
    if one.casefold() == other.casefold():
        return True
    return any(
        _HEXADECIMAL.fullmatch(first) is not None and second.isdecimal() and int(first, 16) == int(second)
        for first, second in ((one, other), (other, one))
    )


def other_notation(serial: str) -> str:
    """Return the decimal form of a serial number that is plainly hexadecimal; "" for any other."""
    return str(int(serial, 16)) if _PLAINLY_HEXADECIMAL.fullmatch(serial) else ""


def serial_shown(serial: str) -> str:
    """Return a serial number for people: as it stands, and in decimal where it is plainly hexadecimal."""
    other = other_notation(serial)
    return f"{serial} ({other})" if other else serial
