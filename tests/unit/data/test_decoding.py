"""Pictures are decoded as they are, and nothing is said about tags that no user asked for."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from cv2.utils import logging

from radiometer.data.decoding import _quiet, decoded


def _tiff(path):
    """Write a TIFF with an exposure tag of EXIF, which OpenCV's library does not know."""
    codes = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000
    tifffile.imwrite(path, codes, extratags=[(33434, "2I", 1, (1, 1000), True), (34867, "I", 1, 100, True)])
    return codes, np.fromfile(path, np.uint8)


def test_codes_come_back_and_nothing_is_said(tmp_path, capfd):
    """Every code is as written; standard error, also that of the library itself, stays empty."""
    codes, content = _tiff(tmp_path / "a.tif")
    assert np.array_equal(decoded(content), codes)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("end", [0, 1, 60])
def test_what_is_no_picture_is_none(end, tmp_path):
    """Nothing, a byte, a file cut within its first strip."""
    assert decoded(_tiff(tmp_path / "a.tif")[1][:end]) is None


def test_a_program_s_own_level_of_remarks_stays(tmp_path):
    """Whoever uses OpenCV beside this keeps what they set."""
    before = logging.setLogLevel(logging.LOG_LEVEL_INFO)
    decoded(_tiff(tmp_path / "a.tif")[1])
    assert logging.setLogLevel(before) == logging.LOG_LEVEL_INFO


def test_threads_that_decode_at_once_leave_the_level_as_it_was():
    """Whichever comes in or goes out first: the level that was set before all of them is there again."""
    before = logging.getLogLevel()
    first, second = _quiet(), _quiet()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert logging.getLogLevel() == logging.LOG_LEVEL_ERROR
    second.__exit__(None, None, None)
    assert logging.getLogLevel() == before != logging.LOG_LEVEL_ERROR
