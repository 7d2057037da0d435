"""Cameras that people own, by name: "v4l2:/dev/video0", "picamera:0", "gphoto2:usb:001,004"."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from drivers.cameras import pi_link, tethered_link, v4l2_link
from drivers.cameras.plain_camera import FrameLink, PlainCamera
from radiometer.data import CameraDescription, LensDescription
from radiometer.devices import CameraIdentity, Finding, Health
from radiometer.errors import DeviceError, DeviceNotFound, MissingLibrary


class _Library(NamedTuple):
    load: Callable[[], object]
    cameras: Callable[[], list[CameraIdentity]]
    link: Callable[[CameraIdentity], FrameLink[Any]]


_LIBRARIES: Final = {
    "v4l2": _Library(v4l2_link.load_library, v4l2_link.listed_cameras, v4l2_link.V4l2Link),
    "picamera": _Library(pi_link.load_library, pi_link.listed_cameras, pi_link.PiLink),
    "gphoto2": _Library(tethered_link.load_library, tethered_link.listed_cameras, tethered_link.TetheredLink),
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
    library = _LIBRARIES[kind]
    matching = [one for one in library.cameras() if not place or one.device_id == name or place in one.model]
    if len(matching) > 1:
        there = ", ".join(f"{one.device_id} ({one.model})" for one in matching)
        raise DeviceNotFound(f"several cameras answer to {name}; name one of them: {there}")
    if not matching and not place:
        raise DeviceNotFound(f"no {kind} camera answers; check its cable and power")
    identity = matching[0] if matching else CameraIdentity("", "", "", name, kind)
    return PlainCamera(library.link(identity), lens, preset)


def listed() -> tuple[list[CameraIdentity], list[str]]:
    """Return the cameras that there are, and why those of a library could not be looked for."""
    found, missing = list[CameraIdentity](), list[str]()
    for library in _LIBRARIES.values():
        try:
            found += library.cameras()
        except MissingLibrary as error:
            missing.append(str(error))
        except DeviceError as error:
            missing.append(f"not looked for: {error}")
    return found, missing


def check_libraries() -> list[Finding]:
    """Return whether each library can be loaded; none is needed for the others."""
    findings = []
    for kind, library in _LIBRARIES.items():
        try:
            library.load()
            findings.append(Finding(f"library {kind}", Health.OK, "loads"))
        except MissingLibrary as error:
            findings.append(Finding(f"library {kind}", Health.NOTE, "is not installed", str(error)))
    return findings
