"""Turns what came over the wire into a Frame with the settings it was exposed under."""

from __future__ import annotations

from drivers.camera_quirks import CameraQuirks
from drivers.frame_stream import RawFrame
from drivers.pixel_unpacking import pixel_format_of_code, unpack_pixels
from radiometer.data import Frame, FrameSettings, LensDescription
from radiometer.devices import CameraSettings
from radiometer.errors import DeviceError

_SAME_EXPOSURE_REL = 1e-3  # the chunk is rounded as the register is; neighbouring settings differ by more


def holds_other_settings(raw: RawFrame, settings: CameraSettings) -> bool:
    """Tell whether a frame's chunks say that it was exposed under other settings than those in force."""
    exposure_us = raw.chunks.get("ExposureTime")
    gain_db = raw.chunks.get("Gain")
    other_exposure = (
        exposure_us is not None
        and abs(exposure_us * 1e-6 - settings.exposure_s) > _SAME_EXPOSURE_REL * settings.exposure_s
    )
    return other_exposure or (gain_db is not None and abs(gain_db - settings.gain_db) > 0.01)


def assemble(
    raw: RawFrame,
    settings: CameraSettings,
    quirks: CameraQuirks,
    bit_depth: int,
    lens: LensDescription,
    temperature_c: float | None,
) -> Frame:
    """Return the frame.

    Args:
        raw: What came over the wire.
        settings: Settings in force, as read back.
        quirks: How the camera's Mono16 is laid out.
        bit_depth: Bits of a digital number.
        lens: Lens in front of the camera.
        temperature_c: Sensor temperature in °C; None where unknown.

    Raises:
        DeviceError: If the picture's format is not the one set, or its payload is too short.
    """
    pixel_format = pixel_format_of_code(raw.format_code)
    if pixel_format is None or pixel_format.name != settings.pixel_format:
        sent = pixel_format.name if pixel_format else f"0x{raw.format_code:08X}"
        raise DeviceError(f"the camera sent {sent} where {settings.pixel_format} was set; configure it again")
    left_aligned = quirks.mono16_left_aligned_bits if pixel_format.name == "Mono16" else 0
    dn = unpack_pixels(
        raw.payload,
        pixel_format.name,
        raw.width,
        raw.height,
        left_aligned_bits=left_aligned,
        big_endian=quirks.mono16_big_endian,
    )
    return Frame(
        dn=dn,
        bit_depth=bit_depth,
        settings=FrameSettings(
            exposure_s=raw.chunks.get("ExposureTime", settings.exposure_s * 1e6) * 1e-6,
            gain_db=raw.chunks.get("Gain", settings.gain_db),
            f_number=lens.f_number,
            black_level_dn=settings.black_level_dn,
            temperature_c=temperature_c,
            timestamp_s=raw.timestamp_s,
        ),
        frame_id=raw.frame_id,
        extra={f"chunk_{name}": value for name, value in raw.chunks.items()},
    )
