"""Where measured and simulated disagree, without any idea of why: places, steps in time and space, repeatability."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.repeatability import estimate_tau
from radiometer.reconciliation.search.localise import axis_of, global_p_value, localise, places
from radiometer.reconciliation.thresholds import SIGNIFICANCE
from testing.reduced import start_of


def _design(times_s, warm_c):
    """Return captures of two frames each, two exposures in turn."""
    frames = tuple(
        FrameEntry(
            file=f"{i}.png",
            exposure_s=1e-3 * (1 + i // 2 % 2),
            timestamp_s=times_s[i // 2],
            temperature_C=warm_c[i // 2],
        )
        for i in range(2 * len(times_s))
    )
    return Design.of(CaptureHeader(camera=CameraDescription(bit_depth=12), frames=frames), (32, 48))


def test_swinging_lamp_is_not_taken_for_poor_repeatability():
    """A swing of 0.6 % within 13 minutes leaves τ near the 0.1 % by which neighbouring captures differ."""
    rng = np.random.default_rng(5)
    captures = 120
    design = _design(np.cumsum(rng.uniform(20.0, 30.0, captures)).tolist(), [35.0] * captures)
    steady = 1e-3 * rng.standard_normal(captures)
    swing = 6e-3 * np.sin(2 * np.pi * design.timestamp_s / 800.0)
    noise = np.full(captures, 1e-10)
    still = estimate_tau(design, steady, noise)
    assert still == pytest.approx(1e-3, rel=4 / np.sqrt(2 * captures))
    # All captures together may raise it, but no further than the repeats allow: a factor of two at least stays open.
    assert still <= estimate_tau(design, steady + swing, noise) < 2.0 * still


def test_one_wrong_capture_is_no_poor_repeatability():
    """A capture that is 26 % brighter than its repeats leaves τ at the 0.1 % of the others, to its uncertainty."""
    rng = np.random.default_rng(6)
    captures = 60
    design = _design((np.arange(captures) * 25.0).tolist(), [20.0 + 5.0 * (i // 4) for i in range(captures)])
    scale = 1e-3 * rng.standard_normal(captures)
    scale[17] += 0.26
    others = np.arange(captures) != 17
    found = estimate_tau(design, np.where(others, scale, 0.0), np.where(others, 1e-10, np.inf))
    assert found == pytest.approx(1e-3, rel=4 / np.sqrt(captures))
    assert estimate_tau(design, scale, np.full(captures, 1e-10)) < 3 * found


def test_setting_repeats_whatever_the_rounding_of_its_temperature():
    """34.7 to 35.3 °C is one temperature although 35 lies on the edge of an even step of 2 K; 45 °C is another."""
    warm = [34.7, 34.9, 35.1, 35.3, 34.8, 35.2, 44.9, 45.1]
    ids = _design(list(np.arange(8) * 25.0), warm).setting_id
    assert ids.tolist() == [0, 1, 0, 1, 0, 1, 2, 3]


@pytest.mark.slow
def test_one_cause_is_one_place(make_capture):
    """A black level 0.5 DN too high differs along a dozen covariates; the list names it once, and no echo."""
    state = start_of(make_capture(seed=3, extra_dn=lambda setting: 0.5))
    tests = localise(state)
    listed = places(state, 4)
    assert len({axis_of(test.where, test.block) for test in listed}) == 4
    limit = np.log(SIGNIFICANCE / len(tests))
    assert sum(test.log_p < limit for test in tests) > 5
    assert [test.log_p < limit for test in listed] == [True, False, False, False]


@pytest.mark.slow
def test_stronger_half_is_a_step_in_the_picture(make_capture):
    """A right half that is 2 % stronger is placed along the width of the picture, as a step of halves."""
    state = start_of(
        make_capture(seed=4, picture=lambda image, setting: image * (1 + 0.02 * (np.arange(image.shape[1]) >= 48)))
    )
    first = places(state, 1)[0]
    assert (first.block, first.where, axis_of(first.where, first.block)) == ("mean", "half_x", "image_x")


@pytest.mark.slow
def test_swinging_lamp_is_placed_along_time(make_capture):
    """A lamp that swings by 1 % three times in the session is placed along time."""
    clock = iter(range(10_000))

    def swing(image, setting):
        return image * (1 + 0.01 * np.sin(2 * np.pi * (next(clock) // 4) / 20.0))

    first = places(start_of(make_capture(seed=5, picture=swing)), 1)[0]
    assert (first.block, axis_of(first.where, first.block)) == ("mean", "timestamp_s")


@pytest.mark.slow
def test_global_p_lies_within_what_overlapping_tests_allow(make_capture):
    """Of tests that overlap the global p lies below Bonferroni's n·p, but not by more than their number of kinds."""
    state = start_of(make_capture(seed=5))
    tests = localise(state)
    for chance in (1e-3, 1e-2):
        best = replace(tests[0], p_value=chance)
        found = global_p_value(state, (best, *tests[1:]))
        assert 0.3 * len(tests) * chance < found <= min(1.25 * len(tests) * chance, 1.0)
    assert global_p_value(state, (replace(tests[0], p_value=1e-9), *tests[1:])) == pytest.approx(len(tests) * 1e-9)
