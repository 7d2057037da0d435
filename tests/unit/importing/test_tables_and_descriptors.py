"""Tables of statistics and EMVA 1288 descriptors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from radiometer.errors import CaptureError, InputError
from radiometer.importing import imported_of, open_capture, statistics_of
from radiometer.importing.emva_listing import EmvaListing


def table(tmp_path, text, name="t.csv"):
    """Write a table."""
    path = tmp_path / name
    path.write_text(text)
    return path


def test_json_lines_with_nested_settings(tmp_path):
    """One object per line, settings one level down, darkness by word."""
    text = (
        '{"settings": {"exposure_s": 0.5, "gain_db": 6}, "mean": 100, "variance": 20, "frames": 8, "pixels": 400}\n'
        '{"settings": {"exposure_s": 0, "shutter": "closed"}, "mean": 10, "variance": 2, "frames": 8, "pixels": 400}\n'
    )
    light, dark = statistics_of(table(tmp_path, text, "t.jsonl")).statistics
    assert (light.gain_db, light.frames, light.pixels, light.shutter) == (6, 8, 400, "open")
    assert (dark.exposure_s, dark.shutter) == (0, "closed")


def test_pixels_from_shares(tmp_path):
    """Shares that are multiples of 1/80000 tell pairs of 40000 pixels, and the clipping code the bits."""
    text = "exposure_ms,mean_dn,variance_dn2,share_at_255\n3,27,140,0\n9,80,300,0.0000125\n30,245,121,0.7542\n"
    header = statistics_of(table(tmp_path, text))
    assert [row.pixels for row in header.statistics] == [40000] * 3
    assert header.camera.bit_depth == 8
    assert header.statistics[2].clipped_share == 0.7542


def test_one_frame_has_no_temporal_variance(tmp_path):
    """A variance over one frame is spatial, so it is not taken for noise."""
    assert statistics_of(table(tmp_path, "exposure_s,mean,var,frames\n1,10,3,1\n")).statistics[0].variance_dn2 is None


def test_a_table_cut_in_half_names_its_row(tmp_path):
    """The line that lacks cells is named."""
    path = table(tmp_path, "exposure_s,mean,variance\n1,10,3\n2,2")
    with pytest.raises(CaptureError, match="line 3"):
        statistics_of(path)


def test_pictures_asked_of_a_table_are_refused(tmp_path):
    """What works on pixels says why it cannot."""
    with pytest.raises(CaptureError, match="characterise"):
        open_capture(table(tmp_path, "exposure_s,mean,variance\n1,10,3\n2,20,6\n"))


def test_a_file_of_another_kind_is_no_table(tmp_path):
    """Columns of luminance are no statistics."""
    assert statistics_of(table(tmp_path, "luminance,f_number,time,iso\n1,2,3,4\n")) is None


@pytest.fixture
def descriptor(tmp_path):
    """Return a function that writes a descriptor over images of given levels."""

    def write(lines):
        text = ["v 3.0", "n 12 8 6"]
        for number, (line, level) in enumerate(lines):
            cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((6, 8), level, np.uint16))
            text += [line, f"i {number}.png"]
        path = tmp_path / "EMVA1288_Data.txt"
        path.write_text("\n".join(text) + "\n")
        return path

    return write


def test_an_exposure_of_zero_is_a_dark_frame(descriptor):
    """d 0 is a bias pair; nanoseconds become seconds."""
    path = descriptor([("d 0", 100), ("b 1000000 500", 900)])
    dark, light = open_capture(path).header.frames
    assert (dark.exposure_s, dark.shutter) == (0, "closed")
    assert (light.exposure_s, light.photons, light.source_level) == (1e-3, 500, 1.0)


def test_photons_count_where_light_does_not_follow_exposure(descriptor):
    """At one exposure the level goes as the photons, and the record says so."""
    capture = open_capture(descriptor([("d 2000000", 100), ("b 2000000 250", 500), ("b 2000000 1000", 1700)]))
    assert [e.source_level for e in capture.header.frames[1:]] == [0.25, 1.0]
    assert any("do not follow the exposure" in line for line in imported_of(capture).doubts)


def test_photons_cut_to_whole_numbers_are_one_light(descriptor):
    """961 photons of 961.8 are no dimmer lamp: the level stays 1."""
    path = descriptor([("d 0", 100), ("b 320000 961", 500), ("b 14020000 42137", 1700)])
    assert [e.source_level for e in open_capture(path).header.frames] == [1.0, 1.0, 1.0]


def test_light_with_an_exposure_of_zero(descriptor):
    """b 0 photons: the photons are the light; a stand-in exposure is stated as such."""
    capture = open_capture(descriptor([("d 0", 100), ("b 0 250", 500), ("b 0 1000", 1700)]))
    assert [e.source_level for e in capture.header.frames[1:]] == [0.25, 1.0]
    assert all(e.exposure_s > 0 for e in capture.header.frames[1:])
    assert any("is assumed" in line for line in imported_of(capture).doubts)


def test_a_negative_exposure_is_refused(descriptor):
    """The line is named."""
    with pytest.raises(InputError, match="line 3"):
        EmvaListing.read(descriptor([("b -5 100", 10)]))
