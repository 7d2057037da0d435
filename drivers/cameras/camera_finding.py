"""Finds a camera by device id, serial number or address."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from types import ModuleType
from typing import Final

from radiometer.data.serials import same_serial, serial_shown
from radiometer.devices import CameraIdentity
from radiometer.errors import DeviceNotFound

FAKE_ID: Final = "Fake_1"  # Aravis's camera inside the library


def listed_cameras(aravis: ModuleType) -> list[CameraIdentity]:
    """Return the cameras that answer on all network interfaces and USB ports; takes about 1 s."""
    aravis.disable_interface("Fake")
    aravis.update_device_list()
    return [_listed(aravis, index) for index in range(aravis.get_n_devices())]


def find_camera(aravis: ModuleType, name: str | None, discover: Callable[[], list[CameraIdentity]]) -> CameraIdentity:
    """Return who is meant by a name.

    Args:
        aravis: The library's module.
        name: Device id, serial number or IP address; None for the only camera connected.
        discover: Lists the cameras; not called for an address or the fake camera.

    Raises:
        DeviceNotFound: If nothing of that name answers, or several cameras do where none was named.
    """
    if name == FAKE_ID:
        aravis.enable_interface("Fake")
        return CameraIdentity("Aravis", "Fake", "1", FAKE_ID, "Fake")
    if name is not None and _is_address(name):
        return CameraIdentity("", "", "", name, f"GigEVision {name}")
    cameras = discover()
    matching = [camera for camera in cameras if name is None or name in (camera.device_id, camera.serial)]
    if not matching and name is not None:
        matching = [camera for camera in cameras if same_serial(camera.serial, name)]
    if len(matching) == 1:
        return matching[0]
    there = ", ".join(f"{camera.device_id} (serial {serial_shown(camera.serial)})" for camera in cameras) or "none"
    if matching:
        raise DeviceNotFound(f"several cameras answer; name one of them: {there}")
    description = f"camera {name}" if name else "camera"
    raise DeviceNotFound(f"no {description} answers; those that do: {there}; check cable, power and address")


def _listed(aravis: ModuleType, index: int) -> CameraIdentity:
    return CameraIdentity(
        vendor=aravis.get_device_vendor(index) or "",
        model=aravis.get_device_model(index) or "",
        serial=aravis.get_device_serial_nbr(index) or "",
        device_id=aravis.get_device_id(index),
        interface=f"{aravis.get_device_protocol(index)} {aravis.get_device_address(index) or ''}".strip(),
    )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return "." in name  # a bare number would be a serial
