"""Frozen objects that travel between stages, each with its uncertainty and provenance."""

from radiometer.data.calibration import (
    BlackLevel,
    Calibration,
    FlatField,
    FoundEffects,
    Scale,
    ScaleConditions,
    SpectralResponse,
    StatedUncertainties,
)
from radiometer.data.capture_header import (
    CameraDescription,
    LensDescription,
    PatchDescription,
    SourceDescription,
    TapDescription,
)
from radiometer.data.capture_set import CaptureHeader, CaptureSet, CaptureSetWriter, FrameEntry, SettingStatistics
from radiometer.data.frame import Bracket, Frame, FrameSettings
from radiometer.data.provenance import Provenance
from radiometer.data.radiance_map import PixelMask, RadianceMap
from radiometer.data.reading import Contribution, Flag, Patch, Quantity, Reading
from radiometer.data.response_curve import ResponseCurve
from radiometer.data.sensor_noise import SensorNoise

__all__ = [
    "BlackLevel",
    "Bracket",
    "Calibration",
    "CameraDescription",
    "CaptureHeader",
    "CaptureSet",
    "CaptureSetWriter",
    "Contribution",
    "Flag",
    "FlatField",
    "FoundEffects",
    "Frame",
    "FrameEntry",
    "FrameSettings",
    "LensDescription",
    "Patch",
    "PatchDescription",
    "PixelMask",
    "Provenance",
    "Quantity",
    "RadianceMap",
    "Reading",
    "ResponseCurve",
    "Scale",
    "ScaleConditions",
    "SensorNoise",
    "SettingStatistics",
    "SourceDescription",
    "TapDescription",
    "SpectralResponse",
    "StatedUncertainties",
]
