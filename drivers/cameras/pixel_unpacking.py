"""Pixel formats of the PFNC: payload bytes to right-aligned digital numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import DigitalNumbers
from radiometer.errors import DeviceError

_Unpack = Callable[[NDArray[np.uint8], int], DigitalNumbers]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A pixel format of one number per pixel: monochrome, or a mosaic of colours."""

    name: str  # PFNC name
    code: int  # PFNC 32-bit value
    bit_depth: int  # bits of a digital number
    bits_per_pixel: int  # bits a pixel takes on the wire
    unpack: _Unpack  # payload bytes and number of pixels → digital numbers
    mosaic: str | None = None  # colours of 2 × 2 pixels row by row; None where monochrome

    def payload_bytes(self, pixel_count: int) -> int:
        """Return the bytes that a picture of so many pixels takes, rounded up."""
        return -(-pixel_count * self.bits_per_pixel // 8)


def unpack_pixels(
    payload: bytes, format_name: str, width: int, height: int, *, left_aligned_bits: int = 0, big_endian: bool = False
) -> DigitalNumbers:
    """Return the digital numbers of a picture, right-aligned, shape (height, width).

    Args:
        payload: What came over the wire; longer than needed where the device pads it.
        width: Picture width in pixels.
        height: Picture height in pixels.
        left_aligned_bits: Significant bits of a Mono16 whose camera shifts them to the top; 0 where it does not.
        big_endian: True where the camera sends Mono16 with the high byte first.

    Raises:
        DeviceError: If the format has not one number per pixel, or the payload is too short.
    """
    pixel_format = RAW_FORMATS.get(format_name)
    if pixel_format is None:
        raise DeviceError(f"pixel format {format_name} cannot be measured with; choose one of {', '.join(RAW_FORMATS)}")
    needed = pixel_format.payload_bytes(width * height)
    if len(payload) < needed:
        raise DeviceError(
            f"a {width} × {height} {format_name} picture takes {needed} bytes, but only {len(payload)} came; "
            "the frame is damaged"
        )
    pixels = pixel_format.unpack(np.frombuffer(payload, dtype=np.uint8, count=needed), width * height)
    if format_name == "Mono16":
        pixels = pixels.byteswap() if big_endian else pixels
        pixels = pixels >> np.uint16(16 - left_aligned_bits) if left_aligned_bits else pixels
    return pixels.reshape(height, width)


def pixel_format_of_code(code: int) -> PixelFormat | None:
    """Return the raw format of a PFNC code; None for any other."""
    return next((known for known in RAW_FORMATS.values() if known.code == code), None)


def _plain_8(payload: NDArray[np.uint8], count: int) -> DigitalNumbers:
    return payload[:count]


def _plain_16(payload: NDArray[np.uint8], count: int) -> DigitalNumbers:
    return payload.view("<u2")[:count].astype(np.uint16, copy=False)


def _groups(payload: NDArray[np.uint8], size: int) -> NDArray[np.uint16]:
    short = -payload.size % size
    return np.pad(payload, (0, short)).reshape(-1, size).astype(np.uint16).T


def _interleave(pixels: list[NDArray[np.uint16]], count: int) -> DigitalNumbers:
    return np.stack(pixels, axis=1).reshape(-1)[:count]


def _mono12_packed(payload: NDArray[np.uint8], count: int) -> DigitalNumbers:
    # GigE Vision 1.x: high bytes outside, both low nibbles in the middle byte.
    first, middle, last = _groups(payload, 3)
    return _interleave([first << 4 | middle & 0x0F, last << 4 | middle >> 4], count)


def _mono10_packed(payload: NDArray[np.uint8], count: int) -> DigitalNumbers:
    # GigE Vision 1.x: as Mono12Packed, with two low bits at bit 0 and bit 4 of the middle byte.
    first, middle, last = _groups(payload, 3)
    return _interleave([first << 2 | middle & 0x03, last << 2 | middle >> 4 & 0x03], count)


def _mono12p(payload: NDArray[np.uint8], count: int) -> DigitalNumbers:
    # PFNC "p": one stream of bits, lowest bit first.
    first, middle, last = _groups(payload, 3)
    return _interleave([first | (middle & 0x0F) << 8, middle >> 4 | last << 4], count)


def _mono10p(payload: NDArray[np.uint8], count: int) -> DigitalNumbers:
    b0, b1, b2, b3, b4 = _groups(payload, 5)
    return _interleave(
        [b0 | (b1 & 0x03) << 8, b1 >> 2 | (b2 & 0x0F) << 6, b2 >> 4 | (b3 & 0x3F) << 4, b3 >> 6 | b4 << 2], count
    )


# Source: EMVA/A3 Pixel Format Naming Convention 2.1, and the PixelFormat entries of FLIR's camera description.
MONO_FORMATS: Final[dict[str, PixelFormat]] = {
    known.name: known
    for known in (
        PixelFormat("Mono8", 0x01080001, 8, 8, _plain_8),
        PixelFormat("Mono10", 0x01100003, 10, 16, _plain_16),
        PixelFormat("Mono10Packed", 0x010C0004, 10, 12, _mono10_packed),
        PixelFormat("Mono10p", 0x010A0046, 10, 10, _mono10p),
        PixelFormat("Mono12", 0x01100005, 12, 16, _plain_16),
        PixelFormat("Mono12Packed", 0x010C0006, 12, 12, _mono12_packed),
        PixelFormat("Mono12p", 0x010C0047, 12, 12, _mono12p),
        PixelFormat("Mono14", 0x01100025, 14, 16, _plain_16),
        PixelFormat("Mono16", 0x01100007, 16, 16, _plain_16),
    )
}
# Last two hexadecimal digits of a mosaic's codes, in the order of `_BAYER_LIKE`. Source: as above. 16 bits are left
# out: whether a camera shifts them to the top is known of Mono16 alone.
_BAYER_LIKE: Final = ("Mono8", "Mono10", "Mono10p", "Mono12", "Mono12p", "Mono12Packed")
_BAYER_CODES: Final = {
    "GRBG": (0x08, 0x0C, 0x56, 0x10, 0x57, 0x2A),
    "RGGB": (0x09, 0x0D, 0x58, 0x11, 0x59, 0x2B),
    "GBRG": (0x0A, 0x0E, 0x54, 0x12, 0x55, 0x2C),
    "BGGR": (0x0B, 0x0F, 0x52, 0x13, 0x53, 0x2D),
}


def _of_mosaic(mosaic: str, like: str, code: int) -> PixelFormat:
    """Return the format of a mosaic whose numbers are packed as those of a monochrome one."""
    grey = MONO_FORMATS[like]
    return replace(grey, name=like.replace("Mono", f"Bayer{mosaic[:2]}"), code=grey.code & ~0xFF | code, mosaic=mosaic)


# Formats with the sensor's number of every pixel.
RAW_FORMATS: Final[dict[str, PixelFormat]] = MONO_FORMATS | {
    known.name: known
    for mosaic, codes in _BAYER_CODES.items()
    for known in (_of_mosaic(mosaic, like, code) for like, code in zip(_BAYER_LIKE, codes, strict=True))
}
