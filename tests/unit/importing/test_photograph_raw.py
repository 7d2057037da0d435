"""Camera raw files: the sensor's own values, linear, per colour."""

import json
import sys

import cv2
import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.errors import CaptureError, MissingLibrary
from radiometer.photographs.folder import read_photographs
from testing.edge_devices import dng_bytes
from testing.photograph_folder import write_photographs

pytest.importorskip("rawpy")
RED, GREEN_1, GREEN_2, BLUE = 1000, 2000, 2002, 3000


def _plain_colours(scale=1.0, white=4095):
    """Return an RGGB mosaic of plain colours, their light above black times a factor."""
    mosaic = np.zeros((64, 96), np.uint16)
    for (row, column), value in {(0, 0): RED, (0, 1): GREEN_1, (1, 0): GREEN_2, (1, 1): BLUE}.items():
        mosaic[row::2, column::2] = min(white, round((value - 64) * scale) + 64)
    return mosaic


def _folder(path, mosaic, **more):
    """Return a folder of one DNG of half a second."""
    return write_photographs(path, [dng_bytes(mosaic, **{"black_dn": 64, **more})], [0.5], ".dng")


def test_raw_file_gives_the_sensors_values(tmp_path):
    """Each colour comes out unscaled at half size, with its black level; values at the white level are saturated."""
    folder = _folder(tmp_path / "a", _plain_colours())
    frames = [bracket.light[0] for bracket in read_photographs(folder, "each")]
    assert [np.unique(frame.dn).tolist() for frame in frames] == [[RED], [GREEN_1], [BLUE]]
    assert [frame.shape for frame in frames] == [(32, 48)] * 3
    assert {frame.bit_depth for frame in frames} == {12}
    assert frames[0].settings.black_level_dn == 64.0
    folder = _folder(tmp_path / "a", _plain_colours(10.0, 3800), white_dn=3800)
    frame = read_photographs(folder, "blue")[0].light[0]
    assert frame.saturated_dn == int(frame.dn.max()) == 3800


@pytest.mark.parametrize("content", [b"nothing of the kind", dng_bytes(np.full((64, 96), 500, np.uint16), 64)[:3000]])
def test_damaged_raw_file_is_named(tmp_path, content):
    """A file that rawpy cannot open, and half a DNG, are refused by name."""
    folder = write_photographs(tmp_path / "a", [content], [0.5], ".nef")
    with pytest.raises(CaptureError, match=r"p0\.nef: not a readable camera raw file"):
        read_photographs(folder)


def test_missing_rawpy_names_the_extra(tmp_path, monkeypatch):
    """Without rawpy the message says how to install it."""
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(MissingLibrary, match=r"radiometer\[photo\]"):
        read_photographs(write_photographs(tmp_path / "a", [b"raw"], [0.5], ".cr2"))


X_TRANS = tuple(tuple(map(int, row)) for row in ("110112", "112110", "201021", "112110", "110112", "021201"))


def test_each_colour_has_its_own_black(tmp_path):
    """Four black levels of a mosaic: red, the green that is read, and blue keep theirs; luminance has their luma."""
    folder = _folder(tmp_path / "a", np.full((64, 96), 500, np.uint16), black_dn=(60, 64, 66, 70))
    levels = [bracket.light[0].settings.black_level_dn for bracket in read_photographs(folder, "each")]
    assert levels == [60.0, 64.0, 70.0]
    luminance = read_photographs(folder, "luminance")[0].light[0].settings.black_level_dn
    assert luminance == pytest.approx(0.299 * 60 + 0.587 * 64 + 0.114 * 70)


def test_an_x_trans_mosaic_is_read_by_cells_of_three(tmp_path):
    """Every cell of 3 × 3 pixels gives one red, green and blue value, of pixels of that colour."""
    codes = np.tile(np.array(X_TRANS), (10, 12))
    place = np.kron(np.arange(20 * 24).reshape(20, 24), np.ones((3, 3), int))
    mosaic = (100 + place + 1000 * codes).astype(np.uint16)
    folder = _folder(tmp_path / "a", mosaic, pattern=X_TRANS)
    frames = [bracket.light[0].dn for bracket in read_photographs(folder, "each")]
    for colour, dn in enumerate(frames):
        assert np.array_equal(dn, 100 + np.arange(20 * 24).reshape(20, 24) + 1000 * colour)


@pytest.mark.parametrize("pattern", [((0, 1), (1, 2)), X_TRANS])
def test_colours_are_filled_in_for_pictures(tmp_path, pattern):
    """At full size an even field of plain colours comes out as these colours above black, white as full scale."""
    colours = np.array([564, 1064, 1564])
    side = len(pattern)
    mosaic = colours[np.tile(np.array(pattern), (60 // side, 96 // side))].astype(np.uint16)
    mosaic[30:36, 40:46] = 4095
    folder = _folder(tmp_path / "a", mosaic, pattern=pattern)
    brackets = read_photographs(folder, "each", interpolated=True)
    for bracket, expected in zip(brackets, (500, 1000, 1500), strict=True):
        frame = bracket.light[0]
        assert frame.shape == (60, 96)
        assert frame.settings.black_level_dn == 0.0
        assert (
            np.abs(frame.dn[8:22, 8:30].astype(int) - expected).max() <= 0.005 * expected
        )  # integer weights of LibRaw
        assert np.all(frame.dn[30:36, 40:46] == 4095)


@pytest.mark.parametrize("pattern", [((0, 1), (1, 2)), X_TRANS])
def test_a_colour_that_clips_says_nothing_of_the_others(tmp_path, pattern):
    """Green at white everywhere leaves red and blue filled in as they are; one clipped red pixel is red around it."""
    side = len(pattern)
    codes = np.tile(np.array(pattern), (60 // side, 96 // side))
    mosaic = np.array([564, 4095, 1564])[codes].astype(np.uint16)
    row, column = next((r, c) for r, c in np.argwhere(codes == 0) if r > 30 and c > 40)
    mosaic[row, column] = 4095
    folder = _folder(tmp_path / "a", mosaic, pattern=pattern)
    red, green, blue = (one.light[0].dn.astype(int) for one in read_photographs(folder, "each", interpolated=True))
    assert np.all(green[4:-4, 4:-4] == 4095)
    assert np.abs(blue[4:-4, 4:-4] - 1500).max() <= 8
    around = np.zeros(codes.shape, bool)
    around[row - 1 : row + 2, column - 1 : column + 2] = True
    clipped = around & (codes != 0)
    clipped[row, column] = True
    assert np.array_equal(red[4:-4, 4:-4] == 4095, clipped[4:-4, 4:-4])
    assert np.abs(red[4:-4, 4:-4][~around[4:-4, 4:-4]] - 500).max() <= 3


def test_raw_and_developed_pictures_do_not_mix(tmp_path):
    """A list that names a raw file and a picture is refused in one line that names both."""
    folder = _folder(tmp_path / "a", np.full((64, 96), 500, np.uint16))
    cv2.imwrite(str(folder / "b.png"), np.full((32, 48, 3), 500, np.uint16))
    (folder / "exposures.txt").write_text("p0.dng 0.5\nb.png 1\n")
    with pytest.raises(CaptureError, match=r"b\.png and p0\.dng are not both camera raw files"):
        read_photographs(folder)


def test_measure_reads_raw_files_by_the_meters_constant_or_a_known_source(tmp_path, capsys):
    """L = K·N²/(t·S), or a known luminance, gives that of another surface within U, 11.6 % of it dark current."""
    rng = np.random.default_rng(1)
    constant, f_number, iso, metered_s = 14.0, 4.0, 100.0, 1.0 / 32.0
    metered = constant * f_number**2 / (metered_s * iso)
    dn_per_light = (2048 - 64) / (metered * metered_s)
    for folder, luminance, times in (("ref", metered, (32,)), ("other", 3.3 * metered, (512, 256, 128))):
        drawn = (rng.poisson(dn_per_light * luminance / d * 2.5, (64, 96)) / 2.5 + 64 for d in times)
        files = (dng_bytes(np.round(dn).astype(np.uint16), 64) for dn in drawn)
        write_photographs(tmp_path / folder, files, [1 / d for d in times], ".dng")
    green = ["--channel", "green", "--f-number", "4"]
    light = ["--spectrum", "equal_energy"]  # stated, or what another light would do is in u too
    meter = ["--luminance-meter-k", "14", "--exposure", "1/32", "--iso", "100", "--reference-dn", "2048"]
    source = ["--patch", "10,10,20,10", "--luminance", str(metered), "--u-rel", "0.02"]
    for words, u_rel in ((meter, 0.19), (source, 0.24)):
        words = ["--force", str(tmp_path / "ref"), *green, *light, *words, "-o", str(tmp_path / "cal.yaml")]
        assert run(["calibrate", *words]) == 0
        capsys.readouterr()
        words = ["--calibration", str(tmp_path / "cal.yaml"), "--patch", "5,5,20,20", "--json"]
        assert run(["measure", "--photographs", str(tmp_path / "other"), *green, *light, *words]) == 0
        found = json.loads(capsys.readouterr().out)["luminance"]
        assert found["value"] == pytest.approx(3.3 * metered, rel=0.01)
        assert 2.0 * found["u"] / found["value"] == pytest.approx(u_rel, rel=0.15)
