"""Raw TIFF with EXIF and XMP: exposure, gain, black level, masked rows, the maker's models."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.errors import CaptureError
from radiometer.importing import imported_of, is_foreign, open_capture
from radiometer.importing.maker_models import FallOff, RowExposure, corners_of_plane
from radiometer.importing.xmp import numbers, read_xmp

PICTURE = ((np.arange(40 * 60).reshape(40, 60) % 3000 + 300) * 16).astype(np.uint16)


def test_exif_becomes_settings(write_raw_tiff):
    """Exposure in s, ISO as dB above ISO 100, black level, padding of four bits."""
    capture = open_capture(write_raw_tiff("a.tif", PICTURE, iso=200, exposure=(1, 500)))
    entry = capture.header.frames[0]
    assert (entry.exposure_s, entry.black_level_dn) == (0.002, 4800)
    assert entry.gain_db == pytest.approx(6.0206, abs=1e-4)
    assert capture.header.camera.code_step_dn == 16
    assert np.array_equal(capture.read_frame(0).dn, PICTURE)


def test_masked_rows_off_the_black_level_tag_are_named(write_raw_tiff):
    """Offset and gain slope of the masked rows are named with their size at each gain."""
    write_raw_tiff("s/a_1.tif", PICTURE, iso=100, dark=5000)
    folder = write_raw_tiff("s/b_1.tif", PICTURE, iso=200, dark=5200).parent
    doubts_found = " ".join(imported_of(open_capture(folder)).doubts)
    assert "+200 DN at 0 dB, +400 DN at 6.02 dB: black_level_offset and black_level_gain_slope" in doubts_found


def test_masked_rows_come_with_the_frame(write_raw_tiff):
    """Readings take the dark level from them."""
    assert open_capture(write_raw_tiff("a.tif", PICTURE, dark=5100)).read_frame(0).masked_dn == 5100.0


def test_masked_rows_at_the_tag_raise_no_doubt(write_raw_tiff):
    """Masked rows that read what the tag says are no finding."""
    doubts_found = imported_of(open_capture(write_raw_tiff("a.tif", PICTURE, dark=4800))).doubts
    assert not any("masked" in line for line in doubts_found)


def test_bands_are_cameras_of_their_own(write_raw_tiff):
    """A folder of two bands is refused as one set; a pattern takes one."""
    write_raw_tiff("s/IMG_1.tif", PICTURE, band="Blue")
    folder = write_raw_tiff("s/IMG_2.tif", PICTURE, band="Red").parent
    with pytest.raises(CaptureError, match=r"Blue.*Red"):
        open_capture(folder)
    assert open_capture(folder / "IMG_2*").header.camera.model_extra["band"] == "Red"


def test_fall_off_is_the_makers_polynomial():
    """Relative illumination 1 + k1·r + k2·r², at a corner 50 px from the centre."""
    model = FallOff((30.0, 40.0), (-0.001, -1e-4))
    assert model.corners((81, 61))[0] == pytest.approx(1 - 0.05 - 0.25)
    assert model.relative_illumination(np.array([30.0]), np.array([40.0]))[0] == 1.0


def test_row_exposure_is_added_per_row():
    """Row 500 at 1 ms with 1e-7 s per row gains 5 %, less a3 per row."""
    assert RowExposure(1e-7, 1e-5).gain_at(500, 1e-3) == pytest.approx(1 + 0.05 - 0.005)


def test_corners_of_a_polynomial_in_x_and_y():
    """Terms x and y² over a frame from 0 to 1, relative to its middle."""
    properties = {"VignettingPolynomial2DName": ("0,0,1,0,0,2",), "VignettingPolynomial2D": ("1,0.2,-0.4",)}
    middle = 1 + 0.1 - 0.1
    assert corners_of_plane(properties) == pytest.approx(np.array([1.0, 1.2, 0.6, 0.8]) / middle)


def test_the_frame_carries_corners_and_row_gain(write_raw_tiff):
    """The maker's models stand in the capture set as numbers a user can judge."""
    header = open_capture(write_raw_tiff("a.tif", PICTURE)).header
    expected = FallOff((30.0, 20.0), (-0.001, -1e-4)).corners((40, 60))
    assert header.lens.model_extra["maker_corner_illumination"] == pytest.approx(expected, abs=1e-4)
    assert header.frames[0].model_extra["maker_row_gain_last"] == pytest.approx(
        1 + 1e-7 * 39 / 0.002 + 5e-6 * 39, abs=1e-4
    )
    doubts = header.model_extra["imported"]["doubts"]
    assert any("0.83 to 0.85 of the middle" in line and "natural_vignetting" in line for line in doubts), doubts
    assert not any("row_dependent_exposure" in line for line in doubts)  # 0.2 % are too little to be reported


def test_rows_that_are_exposed_for_times_of_their_own_are_recognised_by_the_entrys_name(write_raw_tiff):
    """A row more has 0.02 and 0.04 % of the light more at two exposures: 0.8 and 1.6 % over 40 rows."""
    for name, exposure_s in (("a.tif", (1, 2000)), ("b.tif", (1, 4000))):
        path = write_raw_tiff(name, PICTURE, exposure=exposure_s)
    doubts = open_capture(path.parent).header.model_extra["imported"]["doubts"]
    (line,) = [line for line in doubts if "row_dependent_exposure" in line]
    assert "+0.8 to +1.6 % more light than the first" in line


def test_xmp_attributes_and_sequences():
    """Properties are read as attributes and as sequences; a damaged packet gives none."""
    packet = (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        b'<r:Description xmlns:c="u" c:T="32.5"><c:S><r:Seq><r:li>1,2</r:li><r:li>3</r:li></r:Seq></c:S>'
        b"</r:Description></r:RDF></x:xmpmeta>"
    )
    found = read_xmp(packet)
    assert numbers(found, "T") == (32.5,)
    assert numbers(found, "S") == (1.0, 2.0, 3.0)
    assert read_xmp(packet[:-60]) == {}


def test_plain_photographs_are_not_taken_for_raw_frames(tmp_path, write_raw_tiff):
    """A TIFF without a camera's raw facts stays a photograph."""
    import tifffile

    (tmp_path / "photos").mkdir()
    tifffile.imwrite(tmp_path / "photos" / "a.tif", PICTURE)
    assert not is_foreign(tmp_path / "photos")
    assert is_foreign(write_raw_tiff("raw/a.tif", PICTURE).parent)
