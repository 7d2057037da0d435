"""Cameras that people own, by name: "v4l2:/dev/video0", "picamera:0", "gphoto2:usb:001,004"."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from drivers.cameras import pi_link, tethered_link, v4l2_link
from drivers.cameras.pi_link import PicameraLibrary, PiLink
from drivers.cameras.plain_camera import FrameLink, PlainCamera
from drivers.cameras.tethered_link import GphotoLibrary, TetheredLink
from drivers.cameras.v4l2_link import LinuxpyVideo, V4l2Link
from radiometer.data import CameraDescription, LensDescription
from radiometer.devices import CameraIdentity, Finding, Health
from radiometer.errors import DeviceError, DeviceNotFound, MissingLibrary

_LISTED: Final[dict[str, Callable[[], list[CameraIdentity]]]] = {
    "v4l2": v4l2_link.listed_cameras,
    "picamera": pi_link.listed_cameras,
    "gphoto2": tethered_link.listed_cameras,
}


def open_own(name: str, lens: LensDescription | None = None, preset: CameraDescription | None = None) -> PlainCamera:
    """Return a camera by name, ready for `open()`.

    Args:
        name: Library, colon, and path, number or port; nothing behind the colon for the only one there is.

    Raises:
        DeviceNotFound: If there is none, or several where none was named.
        MissingLibrary: If the library is not installed.
    """
    kind, _, place = name.partition(":")
    known = _LISTED[kind]()
    matching = [one for one in known if not place or one.device_id == name or place in one.model]
    if len(matching) > 1:
        there = ", ".join(f"{one.device_id} ({one.model})" for one in matching)
        raise DeviceNotFound(f"several cameras answer to {name}; name one of them: {there}")
    if not matching and not place:
        raise DeviceNotFound(f"no {kind} camera answers; check its cable and power")
    identity = matching[0] if matching else CameraIdentity("", "", "", name, kind)
    return PlainCamera(_link(kind, identity), lens, preset)


def listed() -> tuple[list[CameraIdentity], list[str]]:
    """Return the cameras that there are, and why those of a library could not be looked for."""
    found, missing = list[CameraIdentity](), list[str]()
    for look in _LISTED.values():
        try:
            found += look()
        except MissingLibrary as error:
            missing.append(str(error))
        except DeviceError as error:
            missing.append(f"not looked for: {error}")
    return found, missing


def check_libraries() -> list[Finding]:
    """Return whether each library can be loaded; none is needed for the others."""
    loads = {
        "v4l2": v4l2_link.load_library,
        "picamera": pi_link.load_library,
        "gphoto2": tethered_link.load_library,
    }
    findings = []
    for kind, load in loads.items():
        try:
            load()
            findings.append(Finding(f"library {kind}", Health.OK, "loads"))
        except MissingLibrary as error:
            findings.append(Finding(f"library {kind}", Health.NOTE, "is not installed", str(error)))
    return findings


def _link(kind: str, identity: CameraIdentity) -> FrameLink:
    if kind == "v4l2":
        return V4l2Link(LinuxpyVideo(), identity)
    if kind == "picamera":
        return PiLink(PicameraLibrary(), identity)
    return TetheredLink(GphotoLibrary(), identity)
