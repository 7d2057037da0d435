"""Remembers the USB devices that answered as light boxes: no other device is asked without being named."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from drivers.light_box.serial_line import SerialPort
from radiometer.data.storage import read_yaml, state_folder, write_yaml_atomic
from radiometer.errors import InputError, OutputError

_FORMAT: Final = "radiometer-known-boxes/1"


def is_known(port: SerialPort) -> bool:
    """Return whether a device with this vendor, product and serial number has answered as a light box before.

    A USB device without a serial number is never known: it cannot be distinguished from another of its kind.
    """
    return bool(port.usb_serial) and _identity(port) in _known()


def remember(port: str, plugged: Sequence[SerialPort]) -> None:
    """Remember the USB device behind a port, which has just answered as a light box.

    Where it cannot be stored, the port has to be named next time as well.
    """
    real = os.path.realpath(port)
    device = next((one for one in plugged if os.path.realpath(one.device) == real), None)
    if device is None or not device.usb_serial or is_known(device):
        return
    try:
        _file().parent.mkdir(parents=True, exist_ok=True)
        write_yaml_atomic(_file(), {"format": _FORMAT, "devices": sorted({*_known(), _identity(device)})})
    except (OSError, OutputError):
        return


def _identity(port: SerialPort) -> str:
    return f"{port.vendor_id or 0:04x}:{port.product_id or 0:04x}:{port.usb_serial}"


def _known() -> frozenset[str]:
    try:
        devices = read_yaml(_file()).get("devices")
    except InputError:
        return frozenset()  # none is known: the way out is to name the port once
    return frozenset(map(str, devices)) if isinstance(devices, list) else frozenset()


def _file() -> Path:
    return state_folder() / "known-boxes.yaml"
