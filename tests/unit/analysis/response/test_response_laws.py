"""Laws of the parts of a response: gauges, ratios, thresholds on either side, what is stated of a fit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response import pixel_noise
from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.estimate import compare_thirds
from radiometer.analysis.response.fit import time_error_modes
from radiometer.analysis.response.left_out import error_dn
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.methods import METHODS, method_names
from radiometer.analysis.response.mitsunaga1999 import Gauge, Pairs, with_log_ratios
from radiometer.analysis.response.noise import LogNoise, mean_exposure_dn, slope_at
from radiometer.analysis.response.samples import gather_samples, u_by_groups
from radiometer.analysis.response.settle import places_as_one, tones_as_one
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve
from radiometer.errors import InputError, MeasurementError, UsageError
from radiometer.statistics.jackknife import jackknife_u

LINE = np.log(np.maximum(np.arange(256.0), 0.5) / 128.0)
TIMES = (0.5, 1.0, 2.0, 4.0)


@pytest.fixture(scope="module")
def samples():
    """Return samples of a straight line over four exposures."""
    radiance = np.exp(np.random.default_rng(1).uniform(-4.0, 0.0, (64, 64)))
    frames = [Frame(np.clip(np.round(radiance * t * 250), 0, 255).astype(np.uint8), 8, FrameSettings(t)) for t in TIMES]
    return gather_samples(Bracket.from_frames(frames))


def curve(g, u=0.01, valid=(10, 240)):
    return ResponseCurve(np.asarray(g, dtype=float), np.full(len(g), u), valid_dn=valid)


def test_pairs_are_of_frames_that_follow_and_clear_of_black(samples):
    """Each row is in both frames of its pair, more than 2 % of full scale above black in the shorter one."""
    pairs = Pairs.of(samples, LINE)
    assert pairs.frames.tolist() == [0, 1, 2]
    assert pairs.nominal_log_ratio == pytest.approx([math.log(2.0)] * 3)
    assert pairs.shorter.min() > samples.limits.black_dn + 0.02 * 255
    assert pairs.shorter.min() < samples.limits.black_dn + 0.03 * 255
    assert np.median(pairs.longer / pairs.shorter) == pytest.approx(2.0, rel=0.01)
    some = Pairs.of(samples, LINE, np.array([1]))
    assert (some.frames.tolist(), set(some.pair.tolist())) == ([1], {0})
    assert some.shorter.size == np.count_nonzero(pairs.pair == 1)
    half = pairs.part(pairs.group % 2 == 0)
    assert set((half.group % 2).tolist()) == {0}
    assert half.sigma.size == half.shorter.size == half.longer.size == half.pair.size


def test_a_gauge_brings_ratios_to_what_is_known_of_them(samples):
    """The sum of all stated ones, or those that are held; γ is one factor on all; 1 is no ratio, nor one of no pair."""
    pairs = Pairs.of(samples, LINE)
    stated = Gauge.of(pairs, None)
    wrong = 1.3 * pairs.nominal_log_ratio
    assert stated.exponent(wrong) * wrong == pytest.approx(pairs.nominal_log_ratio)
    known = Gauge.of(pairs, {1: 2.2, 2: 2.0})
    assert known.held == {1: pytest.approx(math.log(2.2)), 2: pytest.approx(math.log(2.0))}
    assert known.exponent(pairs.nominal_log_ratio) == pytest.approx(math.log(4.4) / math.log(4.0))
    assert (known.total, stated.total) == (None, pytest.approx(3.0 * math.log(2.0)))
    for bad in ({7: 2.0}, {0: 1.0}, {0: math.nan}):
        with pytest.raises(UsageError, match="expected a ratio above 1 of one of the pairs 0, 1, 2"):
            Gauge.of(pairs, bad)


def test_recovered_ratios_become_times_from_the_first_frame_on(samples):
    """ln t of the first stays; the others follow by the ratios, in rows and in frames; stated ones change nothing."""
    pairs = Pairs.of(samples, LINE)
    assert with_log_ratios(samples, pairs, pairs.nominal_log_ratio).frame_log_time == pytest.approx(np.log(TIMES))
    found = with_log_ratios(samples, pairs, np.log([3.0, 1.5, 2.0]))
    assert np.exp(found.frame_log_time) == pytest.approx([0.5, 1.5, 2.25, 4.5])
    assert found.log_time == pytest.approx(found.frame_log_time[found.frame])


@pytest.mark.parametrize("gamma", [0.45, 1.0, 2.2])
def test_regions_brought_to_one_value_tell_the_exponent(gamma):
    """ln(t/t′) over the curve's own step is γ; a curve put right by it gives the regions their true exposures."""
    points = [RangePoint(20.0, 1.0 / (20.0 / 128.0) ** gamma), RangePoint(220.0, 1.0 / (220.0 / 128.0) ** gamma)]
    found = dynamic_range(curve(LINE), points, 1.0, 128.0)
    assert found.exponent == pytest.approx(gamma, rel=1e-6)
    assert found.log_steps == pytest.approx([gamma * math.log(20.0 / 128.0), gamma * math.log(220.0 / 128.0)])
    assert found.reduced_chi2 == pytest.approx(0.0, abs=1e-9)
    right = with_dynamic_range(curve(LINE), found)
    assert right.log_exposure[30:230] == pytest.approx(gamma * LINE[30:230], abs=1e-6)
    assert right.log_exposure[128] == 0.0
    single = dynamic_range(curve(LINE), points[:1], 1.0, 128.0)
    assert single.reduced_chi2 is None
    assert single.u_exponent > found.u_exponent


def test_regions_that_disagree_widen_the_exponent_and_the_surer_counts_more():
    """Near black the reading of whole numbers is worse than near white: γ lies nearer the brighter region's."""
    points = [RangePoint(20.0, (128.0 / 20.0) ** 1.2), RangePoint(240.0, (128.0 / 240.0) ** 1.0)]
    each = [dynamic_range(curve(LINE), [one], 1.0, 128.0) for one in points]
    both = dynamic_range(curve(LINE), points, 1.0, 128.0)
    weights = np.array([one.u_exponent for one in each]) ** -2.0
    assert both.exponent == pytest.approx(np.average([1.2, 1.0], weights=weights))
    assert both.reduced_chi2 == pytest.approx(weights @ (np.array([1.2, 1.0]) - both.exponent) ** 2)
    assert both.reduced_chi2 > 1.0
    assert both.u_exponent == pytest.approx(math.sqrt(both.reduced_chi2 / weights.sum()))


@pytest.mark.parametrize(("dn", "taken"), [(128.0 * math.exp(0.201), True), (128.0 * math.exp(0.199), False)])
def test_a_region_is_a_fifth_away_in_ln_exposure_at_least(dn, taken):
    """Nearer to the reference it says nothing of the exponent; and it lies on the curve, at a time above 0."""
    point = RangePoint(dn, 128.0 / dn)
    if taken:
        assert dynamic_range(curve(LINE), [point], 1.0, 128.0).exponent == pytest.approx(1.0, rel=1e-3)
    else:
        with pytest.raises(MeasurementError, match="too near"):
            dynamic_range(curve(LINE), [point], 1.0, 128.0)
    for wrong in (0.0, 255.0):
        with pytest.raises(InputError, match="allowed is above 0 and below 255"):
            dynamic_range(curve(LINE), [replace(point, dn=wrong)], 1.0, 128.0)
    for time_s in (0.0, math.inf, -1.0):
        with pytest.raises(InputError, match="must be above 0"):
            dynamic_range(curve(LINE), [replace(point, exposure_s=time_s)], 1.0, 128.0)


def test_noise_of_a_pixel_is_that_of_electrons_above_black():
    """shot 1/4000 at H = 1 is 4000 e⁻ there; read noise of 10 e⁻; of the top's electrons each DN has its part."""
    g = np.log(np.maximum(np.arange(256.0) - 16.0, 0.5) / 112.0)
    noise = LogNoise(1.0 / 4000.0, (10.0 / 4000.0) ** 2, 0.3, 0.0)
    found = pixel_noise.sensor_noise(noise, curve(g, valid=(20, 240)), 16.0)
    assert found.full_well_e == pytest.approx(4000.0 * 224.0 / 112.0)
    assert found.read_noise_e == pytest.approx(10.0)
    assert found.conversion_gain_e_per_dn == pytest.approx(4000.0 / 112.0)
    assert found.post_curve_dn2 == 0.3
    endless = pixel_noise.sensor_noise(replace(noise, shot=0.0), curve(g, valid=(20, 240)), 16.0)
    assert endless.full_well_e == pytest.approx(1e7)


def test_what_a_curve_does_not_say_is_held_at_its_ends():
    """From the first and last finite number on; a gap is bridged by a line."""
    g = np.array([-np.inf, np.nan, 1.0, np.nan, 3.0, np.inf])
    assert pixel_noise.finite(g).tolist() == [1.0, 1.0, 1.0, 2.0, 3.0, 3.0]


@pytest.mark.parametrize("alike", [1, 3])
def test_tones_that_err_alike_count_as_one(alike):
    """Residuals of runs of equal groups: 1 + 2 Σ ρ is the length of a run; white ones count each."""
    rng = np.random.default_rng(3)
    groups = 3000
    residual = np.concatenate([np.repeat(rng.standard_normal(groups // alike), alike) for _ in range(2)])
    group, frame = np.tile(np.arange(groups), 2), np.repeat([0, 1], groups)
    assert tones_as_one(residual, group, frame) == pytest.approx(float(alike), rel=0.1)
    assert tones_as_one(7.0 * residual, group, frame) == pytest.approx(tones_as_one(residual, group, frame))


@pytest.mark.parametrize(("ratio", "counts"), [(3.99, 1.0), (4.01, 4.01)])
def test_places_differ_beyond_chance_from_fourfold_on(ratio, counts):
    """The ratio of mean variances; below it is one that four quadrants may show by chance."""
    expected = np.array([0.5, 1.5, 1.0])
    assert places_as_one(ratio * expected[::-1], expected) == pytest.approx(counts)


def test_fewer_groups_than_folds_are_left_out_one_by_one(samples):
    """Five groups make five folds; nothing is known of one part."""
    few = samples.kept(samples.group < 5)
    seen = []
    u_by_groups(few, lambda part: seen.append(part.group_count) or np.zeros(1))
    assert seen == [4] * 5
    assert jackknife_u([np.ones(3)]).tolist() == [0.0] * 3
    assert jackknife_u([]).tolist() == [0.0]
    assert jackknife_u([np.array([1.0]), np.array([3.0])]) == pytest.approx([1.0])


def test_a_mean_is_moved_by_half_its_noise_at_most():
    """g = 20·ln M bends more than second order can tell: half a standard deviation, to the side of more light."""
    steep = 20.0 * LINE
    moved = mean_exposure_dn(np.array([120.0]), np.array([400.0 + 1 / 12]), steep, ValueLimits(0, 255))
    assert moved == pytest.approx([130.0])
    flat = mean_exposure_dn(np.array([120.0]), np.array([400.0 + 1 / 12]), 1e-3 * LINE, ValueLimits(0, 255))
    assert flat == pytest.approx([120.0 - 400.0 / 240.0], rel=0.01)


def test_methods_are_called_by_name():
    """One, or all of them; another name is refused with those that there are."""
    assert method_names("auto") == ["auto"]
    assert method_names("all") == list(METHODS)
    with pytest.raises(UsageError, match="'gamma'; choose one of auto, debevec1997"):
        method_names("gamma")


def test_thirds_are_compared_where_all_are_valid():
    """Offsets of 0.1 and 0.2: rms over pairs √((0.01 + 0.04 + 0.01)/3), in units of √2·0.05; 3 numbers tell nothing."""
    thirds = [curve(LINE + off, 0.05) for off in (0.0, 0.1, 0.2)]
    found = compare_thirds(thirds, curve(LINE))
    assert found.rms_log == pytest.approx(math.sqrt(0.02))
    assert found.largest_log == pytest.approx(0.2)
    assert found.reduced_chi2 == pytest.approx(0.02 / 0.005)
    assert compare_thirds(thirds[:2], replace(curve(LINE), valid_dn=None)) is None
    assert compare_thirds(thirds, curve(LINE, valid=(100, 103))) is None
    assert compare_thirds(thirds, curve(LINE, valid=(100, 104))) is not None


@pytest.mark.parametrize("log_time", [np.log(TIMES), np.array([0.0, 1.0, 1.7, 2.2, 3.9])])
def test_errors_of_times_leave_mean_and_exponent_alone(log_time):
    """As many patterns as frames less two, of length 1, at right angles to each other, to 1 and to ln t."""
    modes = time_error_modes(log_time)
    assert modes.shape == (log_time.size, log_time.size - 2)
    assert modes.T @ modes == pytest.approx(np.eye(log_time.size - 2), abs=1e-12)
    assert modes.T @ np.column_stack([np.ones(log_time.size), log_time]) == pytest.approx(0.0, abs=1e-12)


def test_the_error_is_a_mean_size_of_what_is_known():
    """Rows that no other frame shows have none."""
    assert error_dn(np.array([3.0, np.nan, -5.0])) == 4.0


@pytest.mark.parametrize(
    ("apart", "slope"), [(0.02, 0.1 / (1.0 + 2.0 + 5.0 / 3.0)), (0.2, 0.2 / (1.0 + 7.0 + 10.0 / 3.0))]
)
def test_repeats_of_an_exposure_are_no_step(apart, slope, samples):
    """A curve of 0.01 up to 100 DN and 0.03 beyond, at 101: half a step to either side, and a step is 0.1 at least."""
    near = replace(samples, frame_log_time=apart * np.arange(4.0))
    numbers = np.arange(256.0) - 100.0
    kinked = np.where(numbers > 0.0, 0.03, 0.01) * numbers
    assert slope_at(kinked, np.array([101.0]), near) == pytest.approx([slope], rel=1e-6)
