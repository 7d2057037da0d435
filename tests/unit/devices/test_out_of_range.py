"""A value out of range is reported with as many digits as show that it is."""

from __future__ import annotations

import pytest

from radiometer.errors import SettingOutOfRange


@pytest.mark.parametrize(
    ("value", "reported"),
    [
        (50.0, "50 dB"),
        (48.00000001, "48.00000001 dB"),
        (-1e-9, "-1e-09 dB"),
        (48.0 + 7.2e-15, "48.000000000000007 dB"),
        (float("nan"), "nan dB"),
    ],
)
def test_a_hair_beyond_is_seen(value, reported):
    """48 dB is not out of a range that ends at 48 dB; 48.00000001 dB is."""
    error = SettingOutOfRange("camera", "gain", value, 0.0, 48.0, "dB")
    assert str(error) == f"camera: gain {reported} is out of range; allowed is 0 to 48 dB"
