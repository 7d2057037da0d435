"""FITS: what the header says becomes settings; what it contradicts is doubted."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.data import Patch
from radiometer.errors import CaptureError
from radiometer.importing import ImportOptions, imported_of, open_capture

PICTURE = (np.arange(48 * 64).reshape(48, 64) + 1000).astype(np.uint16)


def test_a_header_becomes_settings(write_fits):
    """Exposure in s, temperature in °C, shutter, conversion gain and values above 32767 come out as they were."""
    path = write_fits(
        "a.fits.gz", PICTURE + np.uint16(40_000), EXPTIME=2.5, CCD_TEMP=-5.25, SET_TEMP=-5.0, EGAIN=2.06,
        IMAGETYP="Flat Field", DATE_OBS="2017-09-08T20:48:41.5", INSTRUME="STL", XPIXSZ=24.0,
    )  # fmt: skip
    capture = open_capture(path)
    entry, camera = capture.header.frames[0], capture.header.camera
    assert (entry.exposure_s, entry.temperature_C, entry.shutter) == (2.5, -5.25, "open")
    assert (camera.bit_depth, camera.conversion_gain_e_per_dn, camera.pixel_pitch_um) == (16, 2.06, 24.0)
    assert capture.header.created.startswith("2017-09-08T20:48:41.5")
    assert np.array_equal(capture.read_frame(0).dn, PICTURE + np.uint16(40_000))


@pytest.mark.parametrize("message", ["Bias Frame", "DARK", "zero", "Dark Frame          "])
def test_darkness_is_recognised_by_imagetyp(write_fits, message):
    """Bias and dark frames have a closed shutter, a bias frame an exposure of 0 s."""
    entry = open_capture(write_fits("a.fit", PICTURE, EXPTIME=0.0, IMAGETYP=message)).header.frames[0]
    assert (entry.shutter, entry.exposure_s) == ("closed", 0.0)


def test_a_temperature_in_kelvins(write_fits):
    """268.15 in a header can only be kelvins: -5 °C."""
    entry = open_capture(write_fits("a.fit", PICTURE, EXPTIME=1.0, IMAGETYP="dark", DET_TEMP=268.15)).header.frames[0]
    assert entry.temperature_C == pytest.approx(-5.0)


def test_frames_stand_in_the_order_they_were_taken(write_fits):
    """Times count from the first frame, whatever the names."""
    write_fits("s/b.fits", PICTURE, EXPTIME=1.0, IMAGETYP="dark", DATE_OBS="2020-01-01T00:00:10")
    folder = write_fits("s/a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="dark", DATE_OBS="2020-01-01T00:01:10").parent
    entries = open_capture(folder).header.frames
    assert [(e.file, e.timestamp_s) for e in entries] == [("b.fits", 0.0), ("a.fits", 60.0)]


def test_a_name_that_contradicts_its_header_is_doubted(write_fits):
    """A file called expos1 that holds 60 s is taken as 60 s and named."""
    capture = open_capture(write_fits("darks-expos1-x.0001.fits", PICTURE, EXPTIME=60.0, IMAGETYP="dark"))
    assert capture.header.frames[0].exposure_s == 60.0
    assert any("darks-expos1-x" in line and "60 s" in line for line in imported_of(capture).doubts)


@pytest.mark.parametrize("name", ["dark_0c_1m30s.fits", "dark-expos90s-x.fits", "dark_90000ms.fits", "d_1p5min.fits"])
def test_a_name_that_agrees_raises_no_doubt(write_fits, name):
    """Minutes, seconds and milliseconds in names are understood."""
    assert imported_of(open_capture(write_fits(name, PICTURE, EXPTIME=90.0, IMAGETYP="dark"))).doubts == ()


def test_processing_is_doubted(write_fits):
    """A HISTORY that speaks of dark subtraction and a combined frame are named."""
    path = write_fits(
        "a.fits", PICTURE, ("Dark Subtract with m.fits",), EXPTIME=1.0, IMAGETYP="light", NCOMBINE=5
    )  # fmt: skip
    doubts_found = " ".join(imported_of(open_capture(path)).doubts)
    assert "dark subtract" in doubts_found
    assert "5 frames" in doubts_found


def test_the_cooler_that_had_not_settled_is_doubted(write_fits):
    """A sensor 3 K off the requested temperature is named; 0.2 K is not."""
    warm = open_capture(write_fits("a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="dark", CCD_TEMP=-7.0, SET_TEMP=-10.0))
    fine = open_capture(write_fits("b.fits", PICTURE, EXPTIME=1.0, IMAGETYP="dark", CCD_TEMP=-9.8, SET_TEMP=-10.0))
    assert "-7.0" in imported_of(warm).doubts[0]
    assert imported_of(fine).doubts == ()


def test_a_cube_is_one_frame_per_plane(write_fits):
    """Planes of a cube share the header and keep their order."""
    path = write_fits("c.fits", np.stack([PICTURE, PICTURE + 1, PICTURE + 2]).astype(np.uint16), EXPTIME=1.0)
    capture = open_capture(path)
    assert [int(frame.dn[0, 0]) for frame in capture.frames()] == [1000, 1001, 1002]


def test_crop_and_sampling(write_fits):
    """A crop keeps its region, sampling every n-th row and column of it."""
    path = write_fits("a.fits", PICTURE, EXPTIME=1.0, XPIXSZ=5.0)
    capture = open_capture(path, ImportOptions(crop=Patch(8, 4, 20, 10), sample=2))
    assert np.array_equal(capture.read_frame(0).dn, PICTURE[4:14:2, 8:28:2])
    assert capture.header.camera.pixel_spacing_um == 10.0


def test_floating_point_needs_a_full_scale(write_fits):
    """Floats are refused with the option that takes them; with it, full scale becomes 65535."""
    path = write_fits("f.fits", np.linspace(0, 2, 48 * 64).reshape(48, 64).astype(np.float32), EXPTIME=1.0)
    with pytest.raises(CaptureError, match="--full-scale"):
        open_capture(path)
    dn = open_capture(path, ImportOptions(full_scale=4.0)).read_frame(0).dn
    assert (int(dn[0, 0]), int(dn[-1, -1])) == (0, round(65535 * 2 / 4))


def test_integers_of_32_bits_are_kept_where_they_fit(write_fits):
    """A stated full scale of up to 65535 leaves whole numbers as they are, one above scales them."""
    path = write_fits("i.fits", PICTURE.astype(np.int32) * 10, EXPTIME=1.0)
    assert np.array_equal(open_capture(path, ImportOptions(full_scale=65535)).read_frame(0).dn, PICTURE * 10)
    scaled = open_capture(path, ImportOptions(full_scale=131070)).read_frame(0).dn
    assert int(scaled[0, 0]) == 5000


def test_a_value_above_the_stated_full_scale_is_refused(write_fits):
    """What cannot be is not clipped."""
    path = write_fits("i.fits", PICTURE.astype(np.int32) * 10, EXPTIME=1.0)
    with pytest.raises(CaptureError, match="above the full scale"):
        open_capture(path, ImportOptions(full_scale=20_000))


def test_negative_numbers_need_a_pedestal(write_fits):
    """A dark-subtracted frame is refused with the pedestal that takes it."""
    path = write_fits("n.fits", PICTURE.astype(np.int16) - 1040, EXPTIME=1.0)
    with pytest.raises(CaptureError, match="--pedestal 40"):
        open_capture(path)
    assert int(open_capture(path, ImportOptions(pedestal=40)).read_frame(0).dn[0, 0]) == 0


def test_fewer_bits_are_told_by_where_pixels_pile_up(write_fits):
    """Pixels that pile up at 4095 tell a 12-bit converter in a 16-bit file."""
    capture = open_capture(write_fits("t.fits", np.minimum(PICTURE + 2000, 4095).astype(np.uint16), EXPTIME=1.0))
    assert capture.header.camera.bit_depth == 12


def test_one_filter_of_several_is_a_pattern(write_fits):
    """Frames through two filters see different light; darks belong to neither."""
    write_fits("s/a.fits", PICTURE, EXPTIME=1.0, IMAGETYP="flat", FILTER="R")
    write_fits("s/b.fits", PICTURE, EXPTIME=1.0, IMAGETYP="flat", FILTER="V")
    folder = write_fits("s/c.fits", PICTURE, EXPTIME=1.0, IMAGETYP="dark", FILTER="V").parent
    patterns = {e.file: e.pattern for e in open_capture(folder).header.frames}
    assert patterns == {"a.fits": "R", "b.fits": "V", "c.fits": "default"}


def test_two_cameras_are_not_mixed(write_fits):
    """Frames of two sizes are refused as one set, each named."""
    write_fits("s/a.fits", PICTURE, EXPTIME=1.0, INSTRUME="one")
    folder = write_fits("s/b.fits", PICTURE, EXPTIME=1.0, INSTRUME="two").parent
    with pytest.raises(CaptureError, match=r"2 cameras.*one.*two"):
        open_capture(folder)


def test_no_exposure_anywhere_is_an_error(write_fits):
    """Without an exposure a frame says nothing; the message names it."""
    with pytest.raises(CaptureError, match=r"a\.fits"):
        open_capture(write_fits("a.fits", PICTURE, IMAGETYP="flat"))


@pytest.mark.parametrize(
    ("cards", "white_dn"),
    [
        ({"SATURATE": 50_000}, 50_000), ({"SATLEVEL": 50_000.0}, 50_000), ({"DATAMAX": 9_000}, None),
        ({"SATURATE": (50_000, "saturation level [e-]")}, None), ({"SATURATE": 200_000}, None),
    ],
)  # fmt: skip
def test_a_stated_saturation_is_the_white_level(tmp_path, write_fits, cards, white_dn):
    """SATURATE in DN; DATAMAX is the largest value of one frame, and electrons or numbers beyond 16 bits are none."""
    dn = np.full((20, 30), 9_000, np.uint16)
    for k, seconds in enumerate((1.0, 2.0)):
        write_fits(f"f/{k}.fits", dn + np.uint16(k), EXPTIME=seconds, IMAGETYP="Light", **cards)
    camera = open_capture(tmp_path / "f").header.camera
    assert camera.white_level_dn == white_dn
    assert camera.saturated_dn == (white_dn or 65_535)
