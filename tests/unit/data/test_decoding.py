"""Pictures are decoded as they are, and nothing is stated about tags that no user asked for."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from cv2.utils import logging
from PIL import Image

from radiometer.data.decoding import decoded


def _tiff(path):
    """Write a TIFF with an exposure tag of EXIF, which OpenCV's library does not know."""
    codes = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000
    tifffile.imwrite(path, codes, extratags=[(33434, "2I", 1, (1, 1000), True), (34867, "I", 1, 100, True)])
    return codes, np.fromfile(path, np.uint8)


def test_codes_come_back_and_nothing_is_reported(tmp_path, capfd):
    """Every code is as written; standard error, also that of the library itself, stays empty."""
    codes, content = _tiff(tmp_path / "a.tif")
    assert np.array_equal(decoded(content), codes)
    assert capfd.readouterr().err == ""


def _png(codes, *chunks):
    """Return a PNG's bytes with further chunks after its header."""
    content = cv2.imencode(".png", codes)[1].tobytes()
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return np.frombuffer(content[:33] + b"".join(parts) + content[33:], np.uint8)


def test_a_colour_profile_that_is_wrong_is_no_remark(capfd):
    """A profile of five bytes, which PNG's own library complains of, leaves picture and standard error alone."""
    codes = np.arange(72, dtype=np.uint16).reshape(4, 6, 3) * 900
    content = _png(codes, (b"iCCP", b"a\0\0" + zlib.compress(b"short")))
    assert np.array_equal(decoded(content), codes)
    assert capfd.readouterr().err == ""


def test_what_belongs_to_the_picture_of_a_png_stays():
    """The palette, and which of its colours is transparent, are no remarks: they come back as written."""
    image, written = Image.fromarray(np.array([[0, 1], [1, 2]], np.uint8), "P"), io.BytesIO()
    image.putpalette([10, 20, 30, 40, 50, 60, 70, 80, 90])
    image.save(written, "png", transparency=1)
    found = decoded(np.frombuffer(written.getvalue(), np.uint8))
    assert found[..., :3].tolist() == [[[30, 20, 10], [60, 50, 40]], [[60, 50, 40], [90, 80, 70]]]
    assert found[..., 3].tolist() == [[255, 0], [0, 255]]


@pytest.mark.parametrize("place", [36, -30])
def test_a_damaged_png_is_none_and_nothing_is_reported(place, capfd):
    """One wrong bit in the picture's data is recognised by its check sum, not by the library on standard error."""
    content = _png(np.random.default_rng(1).integers(0, 256, (9, 9), np.uint8)).copy()
    content[place] ^= 4
    assert decoded(content) is None
    assert capfd.readouterr().err == ""


def test_damage_in_a_remark_alone_costs_no_picture():
    """A comment whose check sum is wrong is left out with the others."""
    codes = np.arange(20, dtype=np.uint8).reshape(4, 5)
    content = _png(codes, (b"tEXt", b"Comment\0nothing")).copy()
    content[33 + 8] ^= 1
    assert np.array_equal(decoded(content), codes)


@pytest.mark.parametrize("end", [0, 1, 60])
def test_what_is_no_picture_is_none(end, tmp_path):
    """Nothing, a byte, a file cut within its first strip."""
    assert decoded(_tiff(tmp_path / "a.tif")[1][:end]) is None


def test_a_program_s_own_level_of_remarks_stays(tmp_path):
    """Whoever uses OpenCV next to this keeps what they set."""
    before = logging.setLogLevel(logging.LOG_LEVEL_INFO)
    decoded(_tiff(tmp_path / "a.tif")[1])
    assert logging.setLogLevel(before) == logging.LOG_LEVEL_INFO
