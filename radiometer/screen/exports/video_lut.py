"""Tables for the graphics card that bring a screen to a requested gamma: without any ICC profile."""

from __future__ import annotations

import struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.screen.calibration import ChannelCurve, ScreenCalibration

ENTRIES: Final = 256  # one per level of 8 bits, as graphics cards have
TARGET_GAMMA: Final = 2.2  # usual screens and ArgyllCMS's default


def correction(curve: ChannelCurve, gamma: float = TARGET_GAMMA, entries: int = ENTRIES) -> NDArray[np.float64]:
    """Return the drive 0..1 to be sent for each of `entries` evenly spaced inputs.

    With it the channel's light above its black is the input to the power γ.
    """
    table = curve.table
    low, high = float(table.values[0]), float(table.values[-1])
    target = low + (high - low) * np.linspace(0, 1, entries) ** gamma
    drive = np.array([table.level_of(float(w)) for w in target])
    drive[0], drive[-1] = curve.levels[0] / curve.top_level, curve.levels[-1] / curve.top_level
    return np.maximum.accumulate(drive)


def _channels(calibration: ScreenCalibration) -> list[NDArray[np.float64]]:
    """Return the tables of red, green and blue; grey replaces a primary that was not measured."""
    grey = calibration.channel("grey")
    return [correction(calibration.channels.get(n, grey)) for n in ("red", "green", "blue")]


def to_vcgt(calibration: ScreenCalibration) -> bytes:
    """Return the data of a `vcgt` tag: a table of 3 × 256 numbers of 16 bits, big-endian.

    Source: Apple's video card gamma tag: signature, 4 reserved bytes, type 0 (table), channels, entries, bytes.
    """
    head = struct.pack(">4sIIHHH", b"vcgt", 0, 0, 3, ENTRIES, 2)
    numbers: NDArray[Any] = np.rint(np.array(_channels(calibration)) * 65535).astype(">u2")
    return head + numbers.tobytes()


def to_cal(calibration: ScreenCalibration) -> str:
    """Return ArgyllCMS's .cal text, which `dispwin` loads."""
    red, green, blue = _channels(calibration)
    head = [
        "CAL    ",
        "",
        'DESCRIPTOR "Argyll Device Calibration State"',
        'ORIGINATOR "radiometer screen calibrate"',
        'DEVICE_CLASS "DISPLAY"',
        'COLOR_REP "RGB"',
        "",
        "NUMBER_OF_FIELDS 4",
        "BEGIN_DATA_FORMAT",
        "RGB_I RGB_R RGB_G RGB_B ",
        "END_DATA_FORMAT",
        "",
        f"NUMBER_OF_SETS {ENTRIES}",
        "BEGIN_DATA",
    ]
    inputs = np.linspace(0, 1, ENTRIES)
    rows = [f"{i:.7f} {r:.7f} {g:.7f} {b:.7f}" for i, r, g, b in zip(inputs, red, green, blue, strict=True)]
    return "\n".join([*head, *rows, "END_DATA"]) + "\n"
