"""Exposures of a reading: enough frames to show flicker, and whole periods of it where light permits."""

from __future__ import annotations

import pytest

from radiometer.acquire.exposure_plan import STEADY_FRAMES, STEADY_SHORT_FRAMES, ExposurePlan, steadied


def times(*exposures_s, flicker_hz=None, limit_s=60.0):
    return steadied(ExposurePlan(exposures_s), flicker_hz, limit_s).exposures_s


def test_short_exposures_are_taken_often_enough():
    """At 1 ms nine frames, the given ones among them, the longer one more often."""
    found = times(1e-3, 1.4e-3)
    assert len(found) == STEADY_SHORT_FRAMES >= 5
    assert set(found) == {1e-3, 1.4e-3}


@pytest.mark.parametrize(("planned", "taken"), [(0.0123, 0.01), (0.049, 0.04), (0.0734, 0.05), (1.234, 1.2)])
def test_long_exposures_are_whole_periods_of_mains_light(planned, taken):
    """Multiples of 1/20 s average 100 and 120 Hz, below that multiples of 1/100 s average 100 Hz."""
    found = times(planned)
    assert found == pytest.approx((taken,) * STEADY_FRAMES)


def test_a_known_flicker_sets_the_period():
    """A screen at 60 Hz: 0.04 s holds two of its frames."""
    assert times(0.04, flicker_hz=60.0) == pytest.approx((2 / 60,) * STEADY_FRAMES)


def test_the_time_limit_holds():
    """Three frames of 30 s do not fit into a minute: two stay."""
    assert times(30.0, limit_s=60.0) == pytest.approx((30.0, 30.0))
