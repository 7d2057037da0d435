"""Camera raw files: the sensor's own values, linear, per colour."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

from drivers.photograph_folder import read_photographs
from radiometer.errors import CaptureError, MissingLibrary

RED, GREEN_1, GREEN_2, BLUE = 1000, 2000, 2002, 3000


def _write_dng(path: Path, scale: float = 1.0, white: int = 4095, black: int = 64) -> None:
    """Write a bare DNG with an RGGB mosaic of plain colours (Adobe DNG 1.4, chapters 3 and 4)."""
    mosaic = np.zeros((64, 96), np.uint16)
    for (row, column), value in {(0, 0): RED, (0, 1): GREEN_1, (1, 0): GREEN_2, (1, 1): BLUE}.items():
        mosaic[row::2, column::2] = min(white, round((value - black) * scale) + black)
    matrix = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50708, "s", 0, "Test Camera", True),  # UniqueCameraModel
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, (0, 1, 1, 2), True),  # CFAPattern: red green / green blue
        (50714, "H", 1, black, True),
        (50717, "I", 1, white, True),
        (50721, "2i", 9, matrix, True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags)


def test_raw_file_gives_the_sensors_values(tmp_path):
    """Each colour of the mosaic comes out unscaled at half size, 12 bits, black level beside it."""
    pytest.importorskip("rawpy")
    _write_dng(tmp_path / "a.dng")
    (tmp_path / "exposures.txt").write_text("a.dng 0.5\n")
    frames = [bracket.frames[0] for bracket in read_photographs(tmp_path, "each")]
    assert [np.unique(frame.dn).tolist() for frame in frames] == [[RED], [GREEN_1], [BLUE]]
    assert [frame.shape for frame in frames] == [(32, 48)] * 3
    assert {frame.bit_depth for frame in frames} == {12}
    assert frames[0].settings.black_level_dn == 64.0


def test_raw_white_level_counts_as_saturated(tmp_path):
    """Values at the file's white level, here below 2^12 − 1, are full scale."""
    pytest.importorskip("rawpy")
    _write_dng(tmp_path / "a.dng", scale=10.0, white=3800)
    (tmp_path / "exposures.txt").write_text("a.dng 0.5\n")
    assert int(read_photographs(tmp_path, "blue")[0].frames[0].dn.max()) == 4095


def test_damaged_raw_file_is_named(tmp_path):
    """A file that rawpy cannot open is refused by name."""
    pytest.importorskip("rawpy")
    (tmp_path / "a.nef").write_bytes(b"nothing of the kind")
    (tmp_path / "exposures.txt").write_text("a.nef 0.5\n")
    with pytest.raises(CaptureError, match=r"a\.nef: not a readable camera raw file"):
        read_photographs(tmp_path)


def test_missing_rawpy_names_the_extra(tmp_path, monkeypatch):
    """Without rawpy the message says how to install it."""
    monkeypatch.setitem(sys.modules, "rawpy", None)
    (tmp_path / "a.cr2").write_bytes(b"raw")
    (tmp_path / "exposures.txt").write_text("a.cr2 0.5\n")
    with pytest.raises(MissingLibrary, match=r"radiometer\[photo\]"):
        read_photographs(tmp_path)
