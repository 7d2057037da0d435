"""Turns what came over the wire into a Frame with the settings it was exposed under."""

from __future__ import annotations

from drivers.cameras.camera_quirks import CameraQuirks
from drivers.cameras.chunk_data import exposure_of
from drivers.cameras.frame_stream import RawFrame
from drivers.cameras.pixel_unpacking import pixel_format_of_code, unpack_pixels
from radiometer.data import Frame, FrameSettings, LensDescription
from radiometer.devices import CameraSettings
from radiometer.errors import DeviceError


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
        settings: Settings in force, as read back.
        quirks: How the camera's Mono16 is laid out.
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
            exposure_s=exposure_of(raw, settings),
            gain_db=raw.chunks.get("Gain", settings.gain_db),
            f_number=lens.f_number,
            black_level_dn=settings.black_level_dn,
            temperature_c=temperature_c,
            timestamp_s=raw.timestamp_s,
        ),
        frame_id=raw.frame_id,
        extra={f"chunk_{name}": value for name, value in raw.chunks.items()},
    )
