"""Offset and drift of the box's clock from exchanges."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.light_box.clock import BoxClock, ClockSample
from radiometer.errors import MeasurementError


def exchange(host_s: float, offset_s: float, out_s: float, back_s: float, rate: float = 0.0) -> ClockSample:
    """Return an exchange at a host time with given delays; the box's clock runs `rate` fast."""
    box_s = (host_s + out_s - offset_s) * (1 + rate)
    return ClockSample(host_s, box_s, box_s + 0.001 * (1 + rate), host_s + out_s + 0.001 + back_s)


def test_equal_delays_give_the_exact_offset():
    """With the same delay both ways the offset is exact."""
    assert exchange(10.0, 3.0, 0.004, 0.004).offset_s == pytest.approx(3.0, abs=1e-12)


def test_wire_time_of_unequal_lines_is_taken_out():
    """A short request and a long answer do not shift the offset."""
    sample = ClockSample(10.0, 7.0 + 0.0014, 7.0 + 0.0014, 10.0 + 0.0014 + 0.0036, 0.0014, 0.0036)
    assert sample.offset_s == pytest.approx(3.0, abs=1e-12)
    assert sample.free_delay_s == pytest.approx(0.0, abs=1e-12)


def test_port_without_wire_time_is_recognised():
    """An exchange faster than its bytes on a real wire is taken as it is."""
    sample = ClockSample(10.0, 7.00005, 7.00005, 10.0001, 0.0014, 0.0036)
    assert sample.offset_s == pytest.approx(3.0, abs=1e-9)


def test_one_sided_delay_stays_within_the_stated_bound():
    """A delay on one way only errs by no more than half of it, which the uncertainty states as a rectangle."""
    clock = BoxClock()
    for step in range(100):
        clock.add(exchange(0.25 * step, 3.0, 0.002, 0.0))
    time_s, u_s = clock.host_time_s(20.0)
    assert abs(time_s - 23.0) <= 0.001 + 1e-6
    assert u_s >= 0.001 / np.sqrt(3)


@pytest.mark.parametrize("rate", [2e-4, -2e-4, 4e-3])
def test_drift_is_found_within_its_uncertainty(rate):
    """Drift comes out within three stated standard uncertainties."""
    rng = np.random.default_rng(5)
    clock = BoxClock()
    for step in range(400):
        clock.add(exchange(0.25 * step, 0.0, *rng.exponential(2e-4, 2), rate=rate))
    found = clock.estimate()
    assert abs(found.drift_ppm - 1e6 * rate / (1 + rate)) < 3 * found.u_drift_ppm
    assert found.u_drift_ppm < 5.0


def test_slow_exchanges_do_not_harm():
    """Exchanges that were held up by 20 ms one way are left out of the line."""
    clock = BoxClock()
    for step in range(100):
        clock.add(exchange(0.25 * step, 3.0, 0.02 if step % 3 else 0.0001, 0.0001))
    assert clock.host_time_s(12.0)[0] == pytest.approx(15.0, abs=3e-4)


def test_no_exchange_is_reported():
    """Without any comparison there is no time."""
    with pytest.raises(MeasurementError, match="synchronise"):
        BoxClock().host_time_s(1.0)


def test_one_exchange_is_known_by_its_delay_and_the_rate_by_what_resonators_hold():
    """2 ms there and back: ±1 ms of asymmetry and ±1.25 ms of slack as rectangles; 0.5 % for every second away."""
    clock = BoxClock()
    clock.add(exchange(10.0, 3.0, 0.001, 0.001))
    sample_s = 10.0 + 0.001 - 3.0
    asymmetry, slack = 0.002 / 2 / np.sqrt(3), 0.0025 / 2 / np.sqrt(3)
    for away_s in (0.0, 2.0, -2.0):
        time_s, u_s = clock.host_time_s(sample_s + away_s)
        assert time_s == pytest.approx(sample_s + away_s + 3.0, abs=1e-9)
        assert u_s == pytest.approx(np.sqrt(asymmetry**2 + slack**2 + (0.005 * away_s) ** 2), rel=1e-4)
    assert clock.estimate().u_drift_ppm == pytest.approx(5000.0)


def test_slack_averages_out_and_asymmetry_does_not():
    """A hundred exchanges at one time know the slack ten times better than one; half the least delay stays."""
    clock = BoxClock()
    for _ in range(100):
        clock.add(exchange(10.0, 3.0, 0.001, 0.001))
    asymmetry, slack = 0.002 / 2 / np.sqrt(3), 0.0025 / 2 / np.sqrt(3)
    assert clock.host_time_s(7.001)[1] == pytest.approx(np.hypot(asymmetry, slack / 10.0), rel=1e-4)


def test_the_last_512_exchanges_are_kept():
    """Two minutes of tending a quarter of a second apart: an old clock's rate does not hold a new one back."""
    clock = BoxClock()
    for step in range(600):
        clock.add(exchange(0.25 * step, 3.0, 0.0001, 0.0001))
    assert clock.estimate().samples == 512
    assert clock.samples[0].sent_s == 0.25 * 88


def test_half_a_millisecond_more_than_the_least_delay_is_slack_and_more_is_a_hold_up():
    """An exchange within it moves the line by its own offset, one beyond it does not."""
    for late_s, moves in ((0.00049, True), (0.00051, False)):
        clock = BoxClock()
        clock.add(exchange(10.0, 3.0, 0.0, 0.0))
        clock.add(exchange(10.0, 3.0, late_s, 0.0))
        assert clock.host_time_s(7.0)[0] == pytest.approx(10.0 - late_s / 4 if moves else 10.0, abs=1e-5)
