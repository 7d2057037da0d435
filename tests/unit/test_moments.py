"""Times without a zone: one rule for every file and option, whatever the zone of the machine."""

import datetime as dt
import time

import pytest

from radiometer.adaptation.visits import moment_of_visit
from radiometer.daemon.timestamps import parse_moment
from radiometer.data.text_table import stamp_s
from radiometer.errors import UsageError
from radiometer.moments import moment_of

NOON = 1_795_780_800.0  # 2026-11-27T12:00:00Z in s since 1970
NOW = dt.datetime(2026, 11, 28, tzinfo=dt.UTC)
READERS = {
    "files": lambda text: moment_of(text).timestamp(),
    "log --since": lambda text: parse_moment(text) / 1e6,
    "adapt run --visit": lambda text: moment_of_visit(text, NOW).timestamp(),
    "tables": stamp_s,
}


@pytest.mark.parametrize("zone", ["America/New_York", "Asia/Kolkata"])
@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_time_without_a_zone_is_utc(read, zone, monkeypatch):
    """Far from Greenwich, too; a stated zone counts."""
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        for text in ("2026-11-27T12:00:00", "2026-11-27T12:00:00Z", "2026-11-27T07:00:00-05:00"):
            assert read(text) == NOON
    finally:
        monkeypatch.undo()
        time.tzset()


def test_a_visit_in_the_future_is_refused():
    """A clock or a date is wrong; half a day may be a zone."""
    assert moment_of_visit("2026-11-28T12:00", NOW) > NOW
    with pytest.raises(UsageError, match="2999-01-01 is in the future"):
        moment_of_visit("2999-01-01", NOW)
