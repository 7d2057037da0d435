"""No result depends on the time zone of the machine: a time without a zone is UTC."""

import datetime as dt
import json
import time
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from radiometer.adaptation.visits import moment_of_visit
from radiometer.daemon.timestamps import iso_time, microseconds, parse_moment
from radiometer.data import (
    Calibration,
    CameraDescription,
    CaptureHeader,
    FrameEntry,
    LensDescription,
    Scale,
    SensorNoise,
)
from radiometer.data.provenance import utc_now
from radiometer.data.text_table import stamp_s
from radiometer.errors import CalibrationError, UsageError
from radiometer.importing import open_capture
from radiometer.moments import moment_of

NOON_S = 1_767_268_800  # 2026-01-01T12:00:00Z, as `date -u -d @1767268800` has it
SAME = ["2026-01-01T12:00:00Z", "2026-01-01T12:00:00", "2026-01-01T13:00:00+01:00", "2026-01-02T01:00:00+13:00"]
NOW = dt.datetime(2026, 11, 28, tzinfo=dt.UTC)
CAMERA = CameraDescription(bit_depth=12)
READERS = {
    "files": lambda text: moment_of(text).timestamp(),
    "journal": lambda text: microseconds(text) / 1e6,
    "log --since": lambda text: parse_moment(text) / 1e6,
    "adapt run --visit": lambda text: moment_of_visit(text, NOW).timestamp(),
    "tables": stamp_s,
    "capture sets": lambda text: CaptureHeader(
        camera=CAMERA, frames=(FrameEntry(file="a.png", exposure_s=1.0),), created=text
    ).taken.timestamp(),
}


@pytest.fixture(params=["UTC", "Pacific/Auckland", "America/Los_Angeles", "Asia/Kolkata"], autouse=True)
def machine_zone(request, monkeypatch):
    """Set the zone of the machine, ahead of UTC and behind it."""
    monkeypatch.setenv("TZ", request.param)
    time.tzset()
    yield request.param
    monkeypatch.undo()
    time.tzset()


@pytest.fixture
def calibration():
    """Return a calibration that is valid for one day."""
    scale = Scale(value=1.0, u_rel=0.0, method="known_radiance")
    return Calibration(CAMERA, LensDescription(), scale, None, SensorNoise.of(CAMERA), validity_days=1.0)


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_the_same_moment_is_the_same_number(read):
    """A time without a zone is UTC, a stated zone counts, wherever a text is read."""
    assert [read(text) for text in SAME] == [NOON_S] * 4


def test_moments_are_written_in_utc_and_lie_not_in_the_future():
    """The present to a second; half a day may be a zone."""
    assert moment_of_visit("2026-11-28T12:00", NOW) > NOW
    with pytest.raises(UsageError, match="2999-01-01 is in the future"):
        moment_of_visit("2999-01-01", NOW)
    assert iso_time(NOON_S * 1_000_000) == "2026-01-01T12:00:00.000000Z"
    assert utc_now().endswith("Z")
    assert microseconds(utc_now()) / 1e6 == pytest.approx(time.time(), abs=1.0)


@pytest.mark.parametrize("text", [text for text in SAME if text != "2026-01-01T12:00:00"])
def test_a_calibration_s_age_counts_from_its_moment(text, calibration):
    """Valid for one day: 24 h after noon UTC it is not stale, a second later it is, whatever zone says its date."""
    day_after = dt.datetime(2026, 1, 2, 12, tzinfo=dt.UTC)
    assert not replace(calibration, created=text).is_stale(day_after)
    assert replace(calibration, created=text).is_stale(day_after + dt.timedelta(seconds=1))


def test_a_calibration_file_whose_date_has_no_zone_is_refused(calibration, tmp_path):
    """Its age could be off by a day."""
    calibration.write(tmp_path / "cal.yaml")
    text = (tmp_path / "cal.yaml").read_text()
    assert Calibration.read(tmp_path / "cal.yaml").created == calibration.created.replace("Z", "+00:00")
    (tmp_path / "cal.yaml").write_text(text.replace(calibration.created, calibration.created.rstrip("Z")))
    with pytest.raises(CalibrationError, match="created"):
        Calibration.read(tmp_path / "cal.yaml")


@pytest.mark.parametrize("text", SAME)
def test_an_imported_stack_was_taken_when_its_file_says(tmp_path, text):
    """Two frames of Micro-Manager, the second a minute later: the set's date is that of the first, in UTC."""
    received = [text, text.replace(":00:00", ":01:00", 1)]
    with tifffile.TiffWriter(tmp_path / "a_MMStack.ome.tif") as writer:
        for moment in received:
            message = json.dumps({"Exposure-ms": 4.0, "ReceivedTime": moment, "BitDepth": 12})
            picture = np.full((4, 4), 100, np.uint16)
            writer.write(picture, extratags=[(51123, "s", 0, message, True)], metadata=None, contiguous=False)
    header = open_capture(tmp_path / "a_MMStack.ome.tif").header
    assert microseconds(header.created) == NOON_S * 1_000_000
    assert [entry.timestamp_s for entry in header.frames] == [0.0, 60.0]
