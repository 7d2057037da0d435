from __future__ import annotations

import numpy as np
import pytest

from radiometer.errors import ConfigurationError
from simulators.cameras.pixel_packing import WIRE_FORMATS, pack_pixels


@pytest.mark.parametrize("name", ["Mono10p", "Mono12p"])
@pytest.mark.parametrize("count", [8, 7])
def test_a_bit_stream_holds_the_pixels_lowest_bit_first(name, count):
    """Read as one whole number, the payload has pixel n at bit n × depth (PFNC 2.1)."""
    bits = WIRE_FORMATS[name].bit_depth
    values = np.random.default_rng(1).integers(0, 1 << bits, count).astype(np.uint16)
    payload = pack_pixels(values, name)
    stream = int.from_bytes(payload, "little")
    assert [stream >> bits * n & (1 << bits) - 1 for n in range(count)] == values.tolist()
    assert len(payload) == -(-count * bits // 8)


def test_packed_pairs_share_the_middle_byte():
    """Mono12Packed: high bytes outside, low nibbles in the middle (GigE Vision 1.2)."""
    assert pack_pixels(np.array([0xABC, 0x123], np.uint16), "Mono12Packed") == bytes([0xAB, 0x3C, 0x12])


def test_words_are_little_endian():
    """16-bit formats send the low byte first."""
    assert pack_pixels(np.array([[0x0102]], np.uint16), "Mono16") == b"\x02\x01"


def test_numbers_above_full_scale_are_refused():
    """A number that the format cannot hold is an error, not a wrap-around."""
    with pytest.raises(ConfigurationError, match="4096 DN do not fit Mono12p"):
        pack_pixels(np.array([4096], np.uint16), "Mono12p")


def test_an_unknown_format_is_refused():
    """The message lists the formats."""
    with pytest.raises(ConfigurationError, match="Mono12p"):
        pack_pixels(np.zeros(4, np.uint16), "RGB8Packed")
