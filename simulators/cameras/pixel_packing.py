"""Digital numbers to payload bytes, as a camera lays them out on the wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import DigitalNumbers
from radiometer.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class WireFormat:
    """A pixel format on the wire: PFNC code, bits of a digital number, bits that a pixel takes."""

    code: int
    bit_depth: int
    bits_per_pixel: int


# Codes: EMVA/A3 Pixel Format Naming Convention 2.1. Mono16 of this camera holds 16-bit numbers.
WIRE_FORMATS: Final = {
    "Mono8": WireFormat(0x01080001, 8, 8),
    "Mono10": WireFormat(0x01100003, 10, 16),
    "Mono10p": WireFormat(0x010A0046, 10, 10),
    "Mono12": WireFormat(0x01100005, 12, 16),
    "Mono12p": WireFormat(0x010C0047, 12, 12),
    "Mono12Packed": WireFormat(0x010C0006, 12, 12),
    "Mono16": WireFormat(0x01100007, 16, 16),
    "BayerRG8": WireFormat(0x01080009, 8, 8),
    "BayerRG12": WireFormat(0x01100011, 12, 16),
}


def pack_pixels(dn: DigitalNumbers, format_name: str) -> bytes:
    """Return the payload of a picture.

    Args:
        dn: Digital numbers, any shape, not above the format's full scale.

    Raises:
        ConfigurationError: If the format is unknown or a number is above its full scale.
    """
    wire = WIRE_FORMATS.get(format_name)
    if wire is None:
        raise ConfigurationError(
            f"pixel format {format_name} is not simulated; choose one of {', '.join(WIRE_FORMATS)}"
        )
    if dn.size and int(dn.max()) >> wire.bit_depth:
        raise ConfigurationError(f"{int(dn.max())} DN do not fit {format_name}; the image source gives too many bits")
    flat = dn.ravel()
    if wire.bits_per_pixel == 8:
        return flat.astype(np.uint8, copy=False).tobytes()
    if wire.bits_per_pixel == 16:
        return flat.astype("<u2", copy=False).tobytes()
    if format_name == "Mono12Packed":
        return _packed_pairs(flat.astype(np.uint16, copy=False))
    return _bit_stream(flat.astype(np.uint16, copy=False), wire.bit_depth)


def _packed_pairs(flat: NDArray[np.uint16]) -> bytes:
    pairs = np.pad(flat, (0, flat.size % 2)).reshape(-1, 2)
    low, high = pairs[:, 0], pairs[:, 1]
    packed = np.stack([low >> 4, (high & 0x0F) << 4 | low & 0x0F, high >> 4], axis=1).astype(np.uint8)
    return bytes(packed.tobytes()[: -(-flat.size * 12 // 8)])


def _bit_stream(flat: NDArray[np.uint16], bits: int) -> bytes:
    """Lay the numbers out as one stream of bits, lowest bit first."""
    group = 4 if bits == 10 else 2  # the fewest pixels that fill whole bytes
    lanes = np.pad(flat, (0, -flat.size % group)).reshape(-1, group).astype(np.uint64)
    word = np.bitwise_or.reduce(lanes << (np.arange(group, dtype=np.uint64) * np.uint64(bits)), axis=1)
    stream = word.astype("<u8").view(np.uint8).reshape(-1, 8)[:, : group * bits // 8]
    return bytes(stream.tobytes()[: -(-flat.size * bits // 8)])
