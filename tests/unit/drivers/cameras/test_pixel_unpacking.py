import numpy as np
import pytest

from drivers.cameras.pixel_unpacking import MONO_FORMATS, RAW_FORMATS, pixel_format_of_code, unpack_pixels
from radiometer.errors import DeviceError


def bit_stream(values, bits: int) -> bytes:
    """Pack by the letter of the PFNC: one stream of bits, lowest first."""
    stream = sum(int(value) << (bits * place) for place, value in enumerate(values))
    return stream.to_bytes(-(-len(values) * bits // 8), "little")


def gige_packed(values, bits: int) -> bytes:
    """Pack by the letter of GigE Vision 1.2: high 8 bits apart, the low bits of a pair in the byte between."""
    low = bits - 8
    packed = bytearray()
    for place in range(0, len(values), 2):
        first, *rest = (int(value) for value in values[place : place + 2])
        packed += bytes(
            [first >> low, first & (1 << low) - 1 | (rest[0] & (1 << low) - 1) << 4 if rest else first & (1 << low) - 1]
        )
        packed += bytes([rest[0] >> low]) if rest else b""
    return bytes(packed)


@pytest.mark.parametrize(("pack", "form"), [(bit_stream, "Mono{}p"), (gige_packed, "Mono{}Packed")])
@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("width", [4, 7])
def test_packed_formats_are_unpacked(pack, form, bits, width):
    """Bit streams and GigE's pairs come out as they went in, also where the pixels do not fill the last group."""
    values = np.random.default_rng(4).integers(0, 1 << bits, 3 * width)
    assert unpack_pixels(pack(values, bits), form.format(bits), width, 3).ravel().tolist() == values.tolist()


@pytest.mark.parametrize(
    ("raw", "name", "options", "row"),
    [(b"\x01\x02\x03\x00", f"Mono{bits}", {}, [0x0201, 0x0003]) for bits in (10, 12, 14, 16)]
    + [
        (b"\xf0\xff\x10\x00", "Mono16", {"left_aligned_bits": 12}, [4095, 1]),
        (b"\x01\x02\x03\x00", "Mono16", {"big_endian": True}, [0x0102, 0x0300]),
    ],
)
def test_words_are_little_endian_and_at_the_right_unless_stated(raw, name, options, row):
    """A camera may put its 12 bits at the top of Mono16, or send the high byte first."""
    assert unpack_pixels(raw, name, 2, 1, **options).tolist() == [row]


def test_mono8_stays_bytes():
    """Mono8 is handed on as it is; padding at the end is left out."""
    pixels = unpack_pixels(b"\x01\x02\x03\x04\xff\xff", "Mono8", 2, 2)
    assert pixels.dtype == np.uint8
    assert pixels.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("raw", "name", "message"),
    [
        (bytes(11), "Mono12p", "takes 12 bytes, but only 11 came"),
        (bytes(16), "RGB8Packed", "RGB8Packed cannot be measured with; choose one of Mono8"),
    ],
)
def test_damaged_and_developed_frames_are_refused(raw, name, message):
    """Missing bytes are reported in bytes; a format without the sensor's numbers with those that have them."""
    with pytest.raises(DeviceError, match=message):
        unpack_pixels(raw, name, 4, 2)


@pytest.mark.parametrize("like", ["Mono8", "Mono10", "Mono10p", "Mono12", "Mono12p", "Mono12Packed"])
@pytest.mark.parametrize(("start", "mosaic"), [("RG", "RGGB"), ("GR", "GRBG"), ("GB", "GBRG"), ("BG", "BGGR")])
def test_a_mosaic_is_packed_as_a_monochrome_frame(like, start, mosaic, shared_data):
    """Its format states the filters; codes are those in FLIR's own description."""
    known = RAW_FORMATS[like.replace("Mono", f"Bayer{start}")]
    payload = bytes(range(12))
    assert unpack_pixels(payload, known.name, 2, 2).tolist() == unpack_pixels(payload, like, 2, 2).tolist()
    assert known.mosaic == mosaic
    assert pixel_format_of_code(known.code) is known
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    assert f"{known.code:08x}" in text.lower() or like in ("Mono10", "Mono12")


def test_codes_are_those_of_the_camera_description(shared_data):
    """PFNC codes equal those in FLIR's own description of the target's twin."""
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    for name in ("Mono8", "Mono16", "Mono10Packed", "Mono10p", "Mono12Packed", "Mono12p"):
        known = MONO_FORMATS[name]
        assert f"{known.code:08x}" in text.lower(), name
        assert pixel_format_of_code(known.code) is known
