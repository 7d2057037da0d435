"""Waits for a camera that was lost, and opens it again as it was set."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from radiometer.devices import Camera, CameraIdentity, CameraSettings
from radiometer.errors import DeviceError, MissingLibrary

PAUSE_S: Final = 0.5  # between two tries: what an opening of a camera that is there takes at most


def refuse_another(found: str, known: str) -> None:
    """Refuse a device that answers in place of the one that was lost: all it does would pass for that one's.

    Args:
        found: What it is and its serial number, in words.
        known: The same of the one that was open before.

    Raises:
        DeviceError: If they differ.
    """
    if found != known:
        raise DeviceError(
            f"another device answers, {found}, in place of {known}; connect that one again, or start the program again"
            " to use the other"
        )


def name_of_camera(camera: CameraIdentity) -> str:
    """Return how a camera is named where it could be mistaken for another one."""
    return f"camera {camera.vendor} {camera.model} {camera.serial}"


def reopen(
    camera: Camera, settings: CameraSettings, report: Callable[[str], None], sleep: Callable[[float], None] = time.sleep
) -> None:
    """Close a camera that was lost, and try to open it until it is back with its settings in force.

    Args:
        camera: The camera; nothing more is asked of it before it is open again.
        report: Called with why it cannot be opened or is another camera, once for each reason.
        sleep: Waits so many seconds.

    Raises:
        MissingLibrary: If it can never be opened here.
    """
    known = name_of_camera(camera.identity)
    camera.close()
    reason = ""
    while True:
        try:
            camera.open()
            refuse_another(name_of_camera(camera.identity), known)
            camera.configure(settings)
        except MissingLibrary:
            raise
        except DeviceError as error:
            camera.close()
            if str(error) != reason:
                reason = str(error)
                report(reason)
            sleep(PAUSE_S)
        else:
            return
