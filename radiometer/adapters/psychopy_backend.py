"""The entry in Monitor Center's list of photometers; loaded by PsychoPy as a plugin."""

from __future__ import annotations

from typing import Any

from radiometer.adapters.psychopy import DEVICE_NAME
from radiometer.errors import MissingLibrary

try:
    from psychopy.experiment.monitor import BasePhotometerDeviceBackend
except ImportError as _error:
    raise MissingLibrary("this is a plugin of PsychoPy 2025.2 or later, which is not installed") from _error


class RadiometerPhotometerBackend(BasePhotometerDeviceBackend):  # type: ignore[misc]
    """Names the camera and the class that reads it."""

    backendLabel = DEVICE_NAME  # noqa: N815 (PsychoPy's name)
    deviceClass = "radiometer.adapters.psychopy.RadiometerPhotometer"  # noqa: N815 (PsychoPy's name)

    def getParams(self) -> tuple[dict[str, Any], list[str]]:  # noqa: N802 (PsychoPy's name)
        """Return no parameters: the address comes from the environment."""
        return {}, []
