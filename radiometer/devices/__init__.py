"""Protocols that real and simulated devices share; above this layer they cannot be distinguished."""

from radiometer.devices.camera import (
    AcquisitionCounts,
    Camera,
    CameraCapabilities,
    CameraIdentity,
    CameraSettings,
    Roi,
    refuse_out_of_range,
    refuse_roi_outside,
)
from radiometer.devices.camera_preset import CameraLimits, CameraPreset
from radiometer.devices.display import Display, DisplayPatch
from radiometer.devices.finding import Finding, Health
from radiometer.devices.light_box import (
    ButtonEvent,
    ChannelCapabilities,
    ChannelMode,
    ChannelState,
    ClockEstimate,
    CurrentRange,
    DriveLevel,
    LightBox,
    LightBoxIdentity,
    LightBoxStatus,
    Radiance,
)

__all__ = [
    "Finding", "Health", "AcquisitionCounts", "ButtonEvent", "Camera", "CameraCapabilities", "CameraIdentity",
    "CameraLimits", "CameraPreset", "CameraSettings", "ChannelCapabilities", "ChannelMode", "ChannelState",
    "ClockEstimate", "CurrentRange", "Display", "DisplayPatch", "DriveLevel", "LightBox", "LightBoxIdentity",
    "LightBoxStatus", "Radiance", "Roi", "refuse_out_of_range", "refuse_roi_outside",
]  # fmt: skip
