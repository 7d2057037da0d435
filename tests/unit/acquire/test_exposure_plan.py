"""Exposure plans: every pixel well exposed twice, nothing more than needed, limits respected."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from radiometer.acquire.exposure_plan import (
    ExposurePlan,
    ExposureWindow,
    exposure_ladder,
    plan_exposures,
    repeats_for,
)
from radiometer.data import CameraDescription
from radiometer.errors import SettingOutOfRange, UsageError

CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10500)
LIMITS_S = (11e-6, 30.0)
WINDOW = ExposureWindow.of(CAMERA, 0.0, 64.0)


def cover_of(rates, exposures):
    """Count in how many exposures each rate lies inside the window."""
    signal = np.multiply.outer(np.asarray(exposures), rates)
    return ((signal >= WINDOW.lowest_dn) & (signal <= WINDOW.highest_dn * (1 + 1e-6))).sum(axis=0)


def test_the_window_begins_where_signal_over_noise_reaches_its_minimum():
    """At the lowest signal the photon-transfer law gives just the minimum signal-to-noise ratio."""
    electrons = WINDOW.lowest_dn * 2.6
    noise_e = math.sqrt(electrons + 2.4**2 + 2.6**2 / 12)
    assert electrons / noise_e == pytest.approx(10.0, rel=1e-9)
    assert WINDOW.highest_dn == pytest.approx(0.88 * min(4095 - 64, WINDOW.clipping_dn))


def test_the_window_ends_below_the_earlier_of_full_well_and_converter():
    """A small full well clips before the converter does."""
    small = CAMERA.model_copy(update={"full_well_e": 2600.0})
    assert ExposureWindow.of(small, 0.0, 64.0).clipping_dn == pytest.approx(1000.0)
    assert ExposureWindow.of(CAMERA, 20.0, 64.0).clipping_dn == pytest.approx(4095 - 64)


@settings(deadline=None, max_examples=200)
@example([14.7421875, 14.74609375])
@given(st.lists(st.floats(math.log(30.0), math.log(3e7)), min_size=1, max_size=40))
def test_every_reachable_pixel_is_well_exposed_twice(log_rates):
    """Whatever the scene, each pixel lies between noise floor and clipping in at least two exposures."""
    rates = np.exp(np.array(log_rates))
    plan = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    assert plan.too_bright == 0
    assert plan.too_dark == 0
    assert cover_of(rates, plan.exposures_s).min() >= 2


def test_the_plan_holds_no_frame_that_could_be_left_out():
    """Taking away any one exposure leaves some pixel with less than two."""
    rates = np.geomspace(100.0, 1e7, 500)
    plan = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    for left_out in range(len(plan.exposures_s)):
        rest = [t for k, t in enumerate(plan.exposures_s) if k != left_out]
        assert cover_of(rates, rest).min() < 2


def test_two_separate_brightnesses_need_no_exposures_between():
    """A bright and a dark patch five decades apart take four frames; the empty range between takes none."""
    plan = plan_exposures(np.array([100.0, 1e7]), WINDOW, 0.0, LIMITS_S)
    assert len(plan.exposures_s) == 4


def test_exposures_are_far_enough_apart_to_teach_the_response():
    """No two exposures of a plan are nearer than half a stop."""
    exposures = plan_exposures(np.geomspace(100.0, 1e7, 500), WINDOW, 0.0, LIMITS_S).exposures_s
    assert np.diff(np.log2(exposures)).min() >= 0.5 - 1e-9


def test_unreachable_pixels_are_counted_and_do_not_hold_up_the_rest():
    """Pixels beyond the camera's limits are reported by number."""
    rates = np.array([1e12, 1e12, 1000.0, 1e-3, 0.0, np.inf])
    plan = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    assert plan.too_bright == 3
    assert plan.too_dark == 2
    assert cover_of(np.array([1000.0]), plan.exposures_s)[0] == 2


def test_the_time_limit_gives_up_the_longest_exposures_and_says_so():
    """A plan never takes longer than permitted; that it was cut is stated."""
    rates = np.geomspace(20.0, 1e6, 100)
    whole = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    cut = plan_exposures(rates, WINDOW, 0.0, LIMITS_S, time_limit_s=whole.total_s / 3)
    assert whole.cut_short is False
    assert cut.cut_short is True
    assert cut.total_s <= whole.total_s / 3


def test_repeats_reach_the_uncertainty_asked_for():
    """One pixel at a known signal: n passes bring its relative noise down by √n, by hand."""
    rate = np.array([1000.0])
    plan = plan_exposures(rate, WINDOW, 0.0, LIMITS_S)
    signal_e = rate[0] * 2.6 * np.array(plan.exposures_s)
    information = (signal_e**2 / (signal_e + 2.4**2 + 2.6**2 / 12)).sum()
    expected = math.ceil(1.0 / (information * 0.001**2))
    assert repeats_for(plan, rate, CAMERA, 0.0, 0.001) == expected


@pytest.mark.parametrize("gain_db", [0.0, 6.0, 20.0])
def test_a_plan_covers_the_scene_at_the_gain_it_is_made_for(gain_db):
    """Amplified by hand, every pixel lies in the window of that gain twice, and none above it in both."""
    window = ExposureWindow.of(CAMERA, gain_db, 64.0)
    rates = np.geomspace(100.0, 1e6, 60)
    plan = plan_exposures(rates, window, gain_db, LIMITS_S)
    signal = np.multiply.outer(np.asarray(plan.exposures_s), rates * 10 ** (gain_db / 20))
    inside = (signal >= window.lowest_dn) & (signal <= window.highest_dn * (1 + 1e-6))
    assert inside.sum(axis=0).min() >= 2


def test_repeats_count_gain_and_pixels():
    """A hundred pixels at 12 dB: information by hand from the photon-transfer law at that gain."""
    factor = 10 ** (12 / 20)
    rates = np.full(100, 1000.0)
    plan = plan_exposures(rates, ExposureWindow.of(CAMERA, 12.0, 64.0), 12.0, LIMITS_S)
    signal_e = 1000.0 * 2.6 * np.array(plan.exposures_s)
    noise_e2 = signal_e + 2.4**2 + (2.6 / factor) ** 2 / 12
    expected = math.ceil(1.0 / ((signal_e**2 / noise_e2).sum() * 100 * 1e-5**2))
    assert repeats_for(plan, rates, CAMERA, 12.0, 1e-5) == expected


def test_exposures_that_clip_tell_nothing_of_a_mean():
    """A second exposure a thousand times as long, where the pixels clip, leaves the repeats as they were."""
    rates = np.full(10, 1e4)
    short, both = ExposurePlan((0.1,)), ExposurePlan((0.1, 100.0))
    assert repeats_for(short, rates, CAMERA, 0.0, 1e-4) > 1
    assert repeats_for(both, rates, CAMERA, 0.0, 1e-4) == repeats_for(short, rates, CAMERA, 0.0, 1e-4)
    above, both = CAMERA.model_copy(update={"black_level_dn": 2000.0}), ExposurePlan((0.1, 0.25))
    assert repeats_for(both, rates, above, 0.0, 1e-4) == repeats_for(short, rates, above, 0.0, 1e-4)  # 2500 above 2000
    assert repeats_for(both, rates, CAMERA, 0.0, 1e-4) < repeats_for(short, rates, CAMERA, 0.0, 1e-4)


def test_what_only_the_longest_exposure_clips_is_not_too_bright():
    """Seven decades of light: each pixel has its exposure, whatever the longest does to it."""
    plan = plan_exposures(np.geomspace(30.0, 3e7, 50), WINDOW, 0.0, LIMITS_S)
    assert (plan.too_bright, plan.too_dark) == (0, 0)


def test_a_ladder_has_the_ends_and_the_steps_asked_for():
    """One stop apart from 1 ms to 8 ms."""
    assert exposure_ladder(0.001, 0.008, 1.0, LIMITS_S).exposures_s == pytest.approx((0.001, 0.002, 0.004, 0.008))


def test_a_ladder_s_last_step_is_the_smaller_one():
    """From 1 to 10 ms in whole stops: 1, 2, 4, 8 and then 10, with none left out below the end."""
    plan = exposure_ladder(1e-3, 10e-3, 1.0, LIMITS_S)
    assert plan.exposures_s == pytest.approx((1e-3, 2e-3, 4e-3, 8e-3, 10e-3))


def test_a_ladder_outside_the_limits_is_refused_with_limits_and_unit():
    """The message gives value, limits and unit."""
    with pytest.raises(SettingOutOfRange, match=r"1e-06 s is out of range; allowed is 1\.1e-05 to 30 s"):
        exposure_ladder(1e-6, 1.0, 1.0, LIMITS_S)


@pytest.mark.parametrize(("low", "high", "stops"), [(0.1, 0.01, 1.0), (0.01, 0.1, 0.0), (0.01, 0.1, -1.0)])
def test_a_ladder_that_makes_no_sense_is_misuse(low, high, stops):
    """Ends the wrong way round or steps not above 0."""
    with pytest.raises(UsageError):
        exposure_ladder(low, high, stops, LIMITS_S)


@settings(max_examples=30, deadline=None)
@given(
    bits=st.integers(8, 16),
    gain_e=st.floats(0.05, 20.0),
    read_e=st.floats(0.5, 60.0),
    well_e=st.floats(50.0, 1e5),
    gain_db=st.floats(0.0, 24.0),
)
@example(bits=8, gain_e=0.5, read_e=30.0, well_e=100.0, gain_db=0.0)
def test_every_camera_has_an_octave_to_expose_in(bits, gain_e, read_e, well_e, gain_db):
    """However noisy and shallow: the brightest well exposed pixel is at least twice as bright as the darkest."""
    camera = CameraDescription(bit_depth=bits, conversion_gain_e_per_dn=gain_e, read_noise_e=read_e, full_well_e=well_e)
    window = ExposureWindow.of(camera, gain_db, 8.0)
    assert 0.0 < 2.0 * window.lowest_dn <= window.highest_dn * (1 + 1e-12)
    assert window.highest_dn < window.clipping_dn
