"""JSON and pictures as they are decoded."""

import io
import json
import math
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from cv2.utils import logging
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from radiometer.data.event_journal import read_events
from radiometer.data.json_text import RepeatedKey, json_text, parsed_json
from radiometer.data.tiff_pixels import decoded
from radiometer.errors import RadiometerError
from radiometer.importing.statistics_table import read_statistics_table
from radiometer.importing.tiff_files import read_tiff_headers

_NUMBERS = st.floats() | st.integers() | st.floats(width=32).map(np.float32) | st.integers(-99, 99).map(np.int64)

_CONTENT = st.recursive(
    st.none() | st.booleans() | st.text() | _NUMBERS,
    lambda inner: st.lists(inner) | st.tuples(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


def _refuse(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


@given(_CONTENT)
def test_every_content_is_strict_json(content):
    """No NaN, no infinity, one line, and the same again when written anew; at any depth no key stands twice."""
    text = json_text(content)
    assert json_text(json.loads(text, parse_constant=_refuse)) == json_text(parsed_json(text)) == text
    assert "\n" not in text
    with pytest.raises(RepeatedKey):
        parsed_json(f'[{{"a": [{{"b": 1, "b": {text}}}]}}]')


@given(_NUMBERS)
def test_a_number_stays_what_it_is_or_is_null(number):
    """NaN and infinity are null; any other number comes back to the bit."""
    assert json.loads(json_text([number])) == [number if math.isfinite(number) else None]


def test_arrays_are_lists_and_what_has_no_form_is_refused():
    """An array's NaN is null as well; an object without a JSON form is an error."""
    assert json_text({"u": np.array([1.0, np.nan, -np.inf])}) == '{"u": [1.0, null, null]}'
    with pytest.raises(TypeError):
        json_text(object())


def _beside(path: Path) -> object:
    """Read a TIFF that has this text as Micro-Manager's metadata next to it."""
    tifffile.imwrite(path.with_name("a.tif"), np.zeros((4, 4), np.uint16), metadata=None)
    return read_tiff_headers(path.with_name("a.tif"))


def _within(path: Path) -> object:
    """Read a TIFF that has this text as Micro-Manager's tag."""
    tags = [(51123, "s", 0, path.read_text(), True)]
    tifffile.imwrite(path.with_name("a.tif"), np.zeros((4, 4), np.uint16), extratags=tags, metadata=None)
    return read_tiff_headers(path.with_name("a.tif"))


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("t.json", '[{"exposure_s": 1, "mean": 20, "variance": 4, "%s": 2}]', read_statistics_table),
        ("t.jsonl", '{"mean": 20, "variance": 4, "exposure_s": 1, "%s": 2}\n', read_statistics_table),
        ("run.jsonl", '{"sequence": 0, "kind": "begin", "exposure_s": 1, "%s": 2}\n', read_events),
        ("metadata.txt", '{"FrameKey-0": {"FileName": "a.tif", "exposure_s": 1, "%s": 2}}', _beside),
        ("tag.txt", '{"exposure_s": 1, "%s": 2}', _within),
    ],
)
def test_a_key_that_stands_twice_is_refused_in_every_file(name, text, read, tmp_path):
    """Which of two exposures is meant is not known; another key in its place is read."""
    path = tmp_path / name
    path.write_text(text % "other")
    assert read(path)
    path.write_text(text % "exposure_s")
    with pytest.raises(RadiometerError, match=r"'exposure_s' occurs twice.*leave one out") as refusal:
        read(path)
    assert str(tmp_path) in str(refusal.value)


def _tiff(path):
    """Write a TIFF with an exposure tag of EXIF, which OpenCV's library does not know."""
    codes = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000
    tifffile.imwrite(path, codes, extratags=[(33434, "2I", 1, (1, 1000), True), (34867, "I", 1, 100, True)])
    return codes, np.fromfile(path, np.uint8)


def test_codes_of_pictures_come_back_and_nothing_is_reported(tmp_path, capfd):
    """Palette and transparency too; a program's own level of remarks stays."""
    codes, content = _tiff(tmp_path / "a.tif")
    assert np.array_equal(decoded(content), codes)
    assert capfd.readouterr().err == ""
    before = logging.setLogLevel(logging.LOG_LEVEL_INFO)
    content = _tiff(tmp_path / "a.tif")[1]
    assert [decoded(content[:end]) for end in (0, 1, 60)] == [None] * 3
    assert decoded(content) is not None
    assert logging.setLogLevel(before) == logging.LOG_LEVEL_INFO
    image, written = Image.fromarray(np.array([[0, 1], [1, 2]], np.uint8), "P"), io.BytesIO()
    image.putpalette([10, 20, 30, 40, 50, 60, 70, 80, 90])
    image.save(written, "png", transparency=1)
    found = decoded(np.frombuffer(written.getvalue(), np.uint8))
    assert found[..., :3].tolist() == [[[30, 20, 10], [60, 50, 40]], [[60, 50, 40], [90, 80, 70]]]
    assert found[..., 3].tolist() == [[255, 0], [0, 255]]


def _png(codes, *chunks):
    """Return a PNG's bytes with further chunks after its header."""
    content = cv2.imencode(".png", codes)[1].tobytes()
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return np.frombuffer(content[:33] + b"".join(parts) + content[33:], np.uint8)


@pytest.mark.parametrize(
    ("chunk", "damaged"), [((b"iCCP", b"a\0\0" + zlib.compress(b"short")), 0), ((b"tEXt", b"Comment\0nothing"), 1)]
)
def test_remarks_of_a_png_cost_no_picture_and_no_word(chunk, damaged, capfd):
    """A profile of five bytes, which PNG's own library complains of, and a comment whose check sum is wrong."""
    codes = np.arange(72, dtype=np.uint16).reshape(4, 6, 3) * 900
    content = _png(codes, chunk).copy()
    content[33 + 8] ^= damaged
    assert np.array_equal(decoded(content), codes)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("place", [36, -30])
def test_a_damaged_png_is_none_and_nothing_is_reported(place, capfd):
    """One wrong bit in the picture's data is recognised by its check sum, not by the library on standard error."""
    content = _png(np.random.default_rng(1).integers(0, 256, (9, 9), np.uint8)).copy()
    content[place] ^= 4
    assert decoded(content) is None
    assert capfd.readouterr().err == ""
