"""Parts that the response methods share: limits, groups, noise, gauges, ratios, and what is stated of a fit."""

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response import debevec1997 as debevec
from radiometer.analysis.response.basis import ValueBasis, unseen_factor
from radiometer.analysis.response.curves import rising
from radiometer.analysis.response.displacement import find_displacement
from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.estimate import ResponseEstimate, compare_thirds
from radiometer.analysis.response.fit import time_error_modes
from radiometer.analysis.response.left_out import error_dn, prediction_error_dn
from radiometer.analysis.response.limits import ValueLimits, find_limits, growth_power
from radiometer.analysis.response.methods import DEFAULT_METHOD, METHODS, compare_methods, method_names
from radiometer.analysis.response.mitsunaga1999 import Gauge, Pairs, with_log_ratios
from radiometer.analysis.response.noise import (
    LogNoise,
    fit_log_noise,
    group_residual,
    mean_exposure_dn,
    slope_at,
    value_at,
)
from radiometer.analysis.response.pixel_noise import finite, sensor_noise
from radiometer.analysis.response.samples import gather_samples, u_by_groups
from radiometer.analysis.response.settle import places_as_one, tones_as_one
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve
from radiometer.errors import InputError, MeasurementError, UsageError
from radiometer.statistics.scale import jackknife_u


def test_limits_are_where_values_gather_or_stand_still(make_stack):
    """3500 DN of a sensor, noise behind the clipping, fog at 15 and a knee at 240."""
    frames = [Frame(np.minimum(f.dn, 3500), 12, f.settings) for f in make_stack("linear").light]
    assert find_limits([Bracket.from_frames(frames)]).saturated_dn == 3500
    bracket = _noisy_behind_the_clipping(0.6)
    limits = find_limits([bracket])
    g = np.log(np.maximum(np.arange(256) / 255.0 + 0.01, 1e-9))
    curve = ResponseCurve(g, np.zeros(256), valid_dn=(limits.black_dn + 3, limits.saturated_dn - 1))
    assert find_displacement(bracket, curve).noise.digital == pytest.approx(0.36, rel=0.1)
    limits = find_limits([_film(np.random.default_rng(3), 15, 240, 2.0 ** np.arange(-14, 16, 2))])
    assert limits.black_dn == pytest.approx(15, abs=1)
    assert 235 <= limits.saturated_dn <= 240
    moving = find_limits([_film(np.random.default_rng(3), 15, 240, 2.0 ** np.arange(-2, 4))])
    assert (moving.black_dn, moving.saturated_dn) == (0, 255)
    shown = [find_limits([Bracket.from_frames(frames_of_black((1.0, 2.0), black))]).black_dn for black in (None, 2.5)]
    assert shown[0] < 3
    assert shown[1] == 3


def _noisy_behind_the_clipping(sigma_dn, seed=5):
    """Return frames of a linear sensor that clips at black and white before noise of `sigma_dn` is added to it."""
    rng = np.random.default_rng(seed)
    light = np.exp(rng.uniform(-9.0, 2.0, (120, 160)))
    frames = []
    for time in 2.0 ** np.arange(6):
        clipped = 255.0 * np.clip(0.05 * time * light - 0.01, 0.0, 1.0)
        stored = np.clip(np.rint(clipped + rng.normal(0.0, sigma_dn, light.shape)), 0, 255).astype(np.uint8)
        frames.append(Frame(stored, 8, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


@pytest.mark.parametrize(("sigma_dn", "black_dn", "saturated_dn"), [(0.0, 0, 255), (0.6, 1, 254)])
def test_noise_behind_the_clipping_is_black_and_white_with_it(sigma_dn, black_dn, saturated_dn):
    """What was clipped and got noise afterwards lies at several values: the next one too is no light."""
    limits = find_limits([_noisy_behind_the_clipping(sigma_dn)])
    assert (limits.black_dn, limits.saturated_dn) == (black_dn, saturated_dn)


def test_pixels_count_once_per_frame_that_agrees_and_does_not_clip(make_stack):
    """What moved enters no group; groups double as exposures do."""
    samples = gather_samples(make_stack("linear"))
    assert samples.pixel_count == 192 * 256
    assert samples.dn.max() < samples.limits.saturated_dn
    assert np.all(np.diff(samples.group) >= 0)
    per_frame = np.bincount(samples.frame, samples.pixels)
    assert per_frame.max() <= 192 * 256
    follows = (np.diff(samples.group) == 0) & (np.diff(samples.frame) == 1) & (samples.dn[:-1] > 200)
    ratio = (samples.dn[1:] / samples.dn[:-1])[follows]
    assert np.average(ratio, weights=samples.pixels[:-1][follows]) == pytest.approx(2.0, rel=0.005)
    frames = list(make_stack("gamma", bit_depth=8).light)
    moved = np.array(frames[5].dn)
    moved[:40, :40] = 0
    disturbed = [*frames[:5], Frame(moved, 8, frames[5].settings), *frames[6:]]
    counted = [gather_samples(Bracket.from_frames(stack)) for stack in (frames, disturbed)]
    lost = [c.pixels[c.frame == 5].sum() for c in counted]
    assert lost[0] - lost[1] >= 0.8 * np.sum(np.array(frames[5].dn)[:40, :40] < 250)


def test_noise_parameters_are_found_again_as_electrons():
    """Within 10 % of 4000 rows; shot 1/4000 at H = 1 is 4000 e⁻ there."""
    rng = np.random.default_rng(4)
    g = rng.uniform(-5.0, 0.7, 4000)
    slope = np.exp(-g) / 2000.0
    pixels = np.full(4000, 100.0)
    truth = LogNoise(2e-4, 1e-6, 0.0, 0.0)
    residual = rng.standard_normal(4000) * np.sqrt(truth.variance(g, slope, pixels))
    found = fit_log_noise(residual, np.zeros(4000), g, slope, pixels)
    expected = truth.variance(g, slope, pixels)
    assert found.variance(g, slope, pixels) == pytest.approx(expected, rel=0.1)
    g = np.log(np.maximum(np.arange(256.0) - 16.0, 0.5) / 112.0)
    noise = LogNoise(1.0 / 4000.0, (10.0 / 4000.0) ** 2, 0.3, 0.0)
    found = sensor_noise(noise, curve(g, valid=(20, 240)), 16.0)
    assert found.full_well_e == pytest.approx(4000.0 * 224.0 / 112.0)
    assert found.read_noise_e == pytest.approx(10.0)
    assert found.conversion_gain_e_per_dn == pytest.approx(4000.0 / 112.0)
    assert found.post_curve_dn2 == 0.3
    endless = sensor_noise(replace(noise, shot=0.0), curve(g, valid=(20, 240)), 16.0)
    assert endless.full_well_e == pytest.approx(1e7)


def _film(rng, fog, knee, times):
    """Return frames of a scene through a response that ends in fog below and in a soft knee above."""
    radiance = np.exp(rng.uniform(-6.0, 2.0, (90, 120)))
    frames = []
    for time in times:
        dn = fog + (knee - fog) * (radiance * time / (1.0 + radiance * time)) ** 0.7
        stored = np.clip(np.round(dn + rng.normal(0.0, 0.7, radiance.shape)), 0, 255).astype(np.uint8)
        frames.append(Frame(stored, 8, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


def test_samples_without_a_quadrant_lack_its_pixels():
    """The four parts without a quadrant, and the quadrants themselves, hold the pixels of the whole between them."""
    rng = np.random.default_rng(1)
    radiance = np.exp(rng.uniform(-5.0, 0.0, (64, 64)))
    frames = [
        Frame(np.clip(radiance * t * 255, 0, 255).astype(np.uint8), 8, FrameSettings(float(t))) for t in (1, 2, 4, 8)
    ]
    samples = gather_samples(Bracket.from_frames(frames))
    whole = samples.pixels[samples.frame == 1].sum()
    own = [part.pixels[part.frame == 1].sum() for part in samples.quadrants]
    without = [part.pixels[part.frame == 1].sum() for part in samples.without_quadrant]
    assert sum(own) == pytest.approx(whole, rel=0.05)
    assert sum(without) == pytest.approx(3.0 * whole, rel=0.05)
    assert min(without) > 2.0 * max(own)


def test_a_left_out_row_is_predicted_by_the_other_frames_of_its_group():
    """Behind a straight line a row's prediction is the others' mean exposure times its time; the error is in DN."""
    samples = gather_samples(Bracket.from_frames(_ramp_frames((1.0, 2.0))))
    g = np.log(np.arange(256) + 1e-3)
    errors = prediction_error_dn(samples, g)
    assert np.nanmax(np.abs(errors)) < 1.1  # half a number of rounding in either frame
    doubled = prediction_error_dn(samples, g, np.array([0.0, np.log(1.5)]))
    later = samples.frame == 1
    assert np.nanmedian(doubled[later] / samples.dn[later]) == pytest.approx(0.5, abs=0.02)
    assert np.nanmedian(doubled[~later] / samples.dn[~later]) == pytest.approx(-1.0 / 3.0, abs=0.02)
    assert error_dn(np.array([3.0, np.nan, -5.0])) == 4.0  # rows that no other frame shows have none


@pytest.mark.parametrize(
    ("dn", "expected"),
    [((100, 200), (0.0, 0.0)), ((200, 100), (50.0 - 200.0, 255.0 - 100.0)), ((100, 100), (-50.0, 100.0))],
)
def test_rows_at_the_ends_are_predicted_by_each_other(dn, expected):
    """Where no row of a group is between black and white they count alike; none is NaN. Behind a line, by M/t."""
    samples = gather_samples(Bracket.from_frames(_ramp_frames((1.0, 2.0))))
    two = replace(
        samples,
        dn=np.array(dn, float), log_time=np.log([1.0, 2.0]), group=np.zeros(2, np.intp), frame=np.arange(2),
        pixels=np.ones(2), variance=np.ones(2), limits=ValueLimits(100, 200),
    )  # fmt: skip
    assert prediction_error_dn(two, np.log(np.arange(256) + 1e-9)) == pytest.approx(expected, abs=0.01)


def _ramp_frames(times):
    ramp = np.tile(np.linspace(10.0, 120.0, 128), (64, 1))
    return [Frame(np.round(ramp * t).astype(np.uint8), 8, FrameSettings(t)) for t in times]


def test_ratios_of_exposures_are_means_by_inverse_variance():
    """Steps of 1 ± 1 and 2 ± 2 make 1.2; a fall among values of large u levels these alone."""
    g = np.array([0.0, 1.0, 2.0, 3.0, 9.0, 4.0, 5.0, 6.0])
    u = np.array([0.1, 0.1, 0.1, 0.1, 9.0, 0.1, 0.1, 0.1])
    level = rising(g, u, (0, 7))
    assert np.all(np.diff(level) >= 0)
    assert np.max(np.abs(level - g)[[0, 1, 2, 3, 5, 6, 7]]) < 0.01
    pairs = Pairs(
        shorter=np.array([10, 10]),
        longer=np.array([20, 30]),
        pair=np.array([0, 0]),
        sigma=np.array([1.0, 2.0]),
        group=np.array([0, 1]),
        nominal_log_ratio=np.array([0.7, 0.69]),
        frames=np.array([0, 1]),
    )
    assert pairs.log_ratios(0.1 * np.arange(256.0)) == pytest.approx([1.2, 0.69])


LINE = np.log(np.maximum(np.arange(256.0), 0.5) / 128.0)

TIMES = (0.5, 1.0, 2.0, 4.0)


def curve(g, u=0.01, valid=(10, 240)):
    return ResponseCurve(np.asarray(g, dtype=float), np.full(len(g), u), valid_dn=valid)


def test_pairs_are_clear_of_black_and_brought_to_what_is_known(samples):
    """More than 2 % of full scale above it; γ is one factor on all ratios."""
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


def test_a_curve_is_held_at_its_ends_and_moved_by_half_its_noise_at_most():
    """A gap is bridged by a line; g = 20·ln M bends more than second order can follow."""
    g = np.array([-np.inf, np.nan, 1.0, np.nan, 3.0, np.inf])
    assert finite(g).tolist() == [1.0, 1.0, 1.0, 2.0, 3.0, 3.0]
    steep = 20.0 * LINE
    moved = mean_exposure_dn(np.array([120.0]), np.array([400.0 + 1 / 12]), steep, ValueLimits(0, 255))
    assert moved == pytest.approx([130.0])
    flat = mean_exposure_dn(np.array([120.0]), np.array([400.0 + 1 / 12]), 1e-3 * LINE, ValueLimits(0, 255))
    assert flat == pytest.approx([120.0 - 400.0 / 240.0], rel=0.01)


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


def test_folds_and_their_jackknife(samples):
    """Five groups make five folds; s² = (F − 1)/F·Σ(θ_f − θ̄)², widened by (F − 1)/(F − 3), of ten."""
    few = samples.kept(samples.group < 5)
    seen = []
    u_by_groups(few, lambda part: seen.append(part.group_count) or np.zeros(1))
    assert seen == [4] * 5
    assert jackknife_u([np.ones(3)]).tolist() == [0.0] * 3
    assert jackknife_u([]).tolist() == [0.0]
    assert jackknife_u([np.array([1.0]), np.array([3.0])]) == pytest.approx([1.0])
    left = []

    def solve(part):
        left.append(np.array([part.dn.mean()]))
        return left[-1]

    found = u_by_groups(samples, solve)
    values = np.array(left)
    assert len(left) == 10
    assert found == pytest.approx(np.sqrt(0.9 * ((values - values.mean(0)) ** 2).sum(0) * 9 / 7))


def test_methods_are_called_by_name_and_thirds_compared():
    """Another name is refused; offsets by rms over pairs in units of their u."""
    assert method_names("auto") == ["auto"]
    assert method_names("all") == list(METHODS)
    assert DEFAULT_METHOD in METHODS
    with pytest.raises(UsageError, match="'gamma'; choose one of auto, debevec1997"):
        method_names("gamma")
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


@pytest.mark.parametrize(
    ("apart", "slope"), [(0.02, 0.1 / (1.0 + 2.0 + 5.0 / 3.0)), (0.2, 0.2 / (1.0 + 7.0 + 10.0 / 3.0))]
)
def test_repeats_of_an_exposure_are_no_step(apart, slope, samples):
    """A curve of 0.01 up to 100 DN and 0.03 beyond, at 101: half a step to either side, and a step is 0.1 at least."""
    near = replace(samples, frame_log_time=apart * np.arange(4.0))
    numbers = np.arange(256.0) - 100.0
    kinked = np.where(numbers > 0.0, 0.03, 0.01) * numbers
    assert slope_at(kinked, np.array([101.0]), near) == pytest.approx([slope], rel=1e-6)


def test_residuals_and_slopes_are_those_by_hand(samples):
    """From the group's weighted mean; over half a stop to either side ln 2."""
    rng = np.random.default_rng(2)
    log_exposure, weight = rng.normal(size=samples.dn.size), rng.uniform(0.5, 2.0, samples.dn.size)
    residual, share = group_residual(samples, log_exposure, weight)
    for group in np.unique(samples.group)[:20]:
        rows = samples.group == group
        light = (log_exposure - samples.log_time)[rows]
        assert residual[rows] == pytest.approx(light - np.average(light, weights=weight[rows]))
        assert share[rows] == pytest.approx(weight[rows] / weight[rows].sum())
    g = np.log(np.maximum(np.arange(256.0), 0.5))
    found = slope_at(g, np.array([60.0, 100.0]), samples)
    assert found == pytest.approx(np.log(2.0) / (np.array([60.0, 100.0]) * (2**0.5 - 2**-0.5)), rel=2e-3)
    assert value_at(g, np.array([10.5])) == pytest.approx((g[10] + g[11]) / 2)


def frames_of_black(times, black_dn=None, top=250.0):
    radiance = np.exp(np.random.default_rng(1).uniform(-4.0, 0.0, (64, 64)))
    return [
        Frame(
            np.clip(np.round(radiance * t * top), 0, 255).astype(np.uint8),
            8,
            FrameSettings(float(t), black_level_dn=black_dn),
        )
        for t in times
    ]


def test_ratios_of_exposures_become_times(samples):
    """1, 2 and 8 s are ratios of 2 and 4; ln t of the first stays, the others follow by the ratios."""
    found = debevec.recover_response_debevec1997(Bracket.from_frames(frames_of_black((1.0, 2.0, 8.0))))
    assert found.exposure_ratios == pytest.approx([2.0, 4.0])
    assert found.u_exposure_ratios.tolist() == [0.0, 0.0]
    pairs = Pairs.of(samples, LINE)
    assert with_log_ratios(samples, pairs, pairs.nominal_log_ratio).frame_log_time == pytest.approx(np.log(TIMES))
    found = with_log_ratios(samples, pairs, np.log([3.0, 1.5, 2.0]))
    assert np.exp(found.frame_log_time) == pytest.approx([0.5, 1.5, 2.25, 4.5])
    assert found.log_time == pytest.approx(found.frame_log_time[found.frame])


def test_what_no_difference_shows_counts_by_its_square(samples, monkeypatch):
    """A doubt twice as large brings four times the variance, at every number."""
    variance = []
    for factor in (0.0, 1.0, 2.0):
        monkeypatch.setattr(debevec, "unseen_factor", lambda *_, factor=factor: factor)
        variance.append(debevec.curve_debevec1997(samples).u_log_exposure[40:200] ** 2)
    assert variance[2] - variance[0] == pytest.approx(4.0 * (variance[1] - variance[0]), rel=1e-6, abs=1e-14)
    assert (variance[1] > variance[0]).mean() > 0.9


def test_bends_that_are_alike_are_trusted_and_one_alone_is_not():
    """Twice √(mean of b⁴)/mean of b² of the third differences: 2 where all are one, 2·√n where one of n is."""
    basis, size = ValueBasis(8, ValueLimits(0, 255)), ValueBasis(8, ValueLimits(0, 255)).size
    nothing, k = np.zeros((size, size)), np.arange(float(size))
    assert unseen_factor(k**3 / 6.0, nothing, basis, (0, 255)) == pytest.approx(2.0)
    step = np.where(k >= 59, (k - 59) * (k - 58) / 2.0, 0.0)
    counted = [unseen_factor(step, nothing, basis, valid) for valid in ((0, 255), (40, 215))]
    assert counted[0] > counted[1] > 10.0
    spread = np.zeros((size, size))
    spread[60, 60] = 4.0  # in three differences too: 1, 9, 9 and 1 times the variance
    n = (counted[0] / 2.0) ** 2
    expected = 2.0 * np.sqrt((1 + 81 + 81 + 1) / n) / ((1 + 9 + 9 + 1) / n)
    assert unseen_factor(np.zeros(size), spread, basis, (0, 255)) == pytest.approx(expected)


def estimate(log_exposure, u, method="one", channel="mono", valid=(0, 255)):
    curve = ResponseCurve(log_exposure, np.full(256, u), valid_dn=valid, channel=channel)
    return ResponseEstimate(curve, method, 1, 1, 1, 0.0, 0.0, None, np.ones(1), np.zeros(1))


def test_methods_are_held_against_both_their_uncertainties():
    """Curves that differ by ±0.1 with u of 0.03 and 0.04: 0.1 rms, 2 of 0.05; a step between them is no difference."""
    line = np.linspace(-40.0, 20.0, 256)
    other = line + 0.1 * (-1.0) ** np.arange(256)
    (found,) = compare_methods([estimate(line, 0.03), estimate(other + 7.0, 0.04, "two")])
    assert (found.first, found.second) == ("one", "two")
    assert found.rms_log == pytest.approx(0.1, rel=1e-3)
    assert found.largest_sigma == pytest.approx(2.0, rel=0.01)
    bump = line.copy()
    bump[100] += 0.2
    (found,) = compare_methods([estimate(line, 0.03), estimate(bump, 0.04, "two")])
    assert (found.at_dn, found.largest_sigma) == (100, pytest.approx(4.0, rel=0.02))
    colours = [estimate(line, 0.03, channel=c) for c in ("red", "green")]
    assert compare_methods(colours) == []


FULL = 4095  # a 128th of it, by which a peak may move, is 31


def frame(dn, seconds=1.0):
    return Frame(np.asarray(dn, np.uint16).reshape(10, -1), 12, FrameSettings(seconds))


@pytest.mark.parametrize(("value", "message"), [(FULL, "67 % .*saturated, 33 % black.*shorter"), (0, "33 % .*longer")])
def test_where_all_is_clipped_it_is_reported_which_way_to_go(value, message):
    """More white than black calls for shorter exposures, more black for longer ones."""
    values = np.repeat([value, value, FULL - value], 10)
    with pytest.raises(MeasurementError, match=message):
        find_limits([Bracket.from_frames([frame(values), frame(values, 2.0)])])


def with_peak(value, part=0.06):
    """Return 1000 values, a part of them one, the rest evenly over all others."""
    dn = np.linspace(200, 3900, 1000).round()
    dn[: round(part * dn.size)] = value
    return frame(np.where((np.abs(dn - value) < 40) & (dn != value), 2500, dn)).dn


def black_of(values, times, part=0.06):
    """Return black of frames in each of which a part of the picture has one value."""
    frames = [
        Frame(with_peak(value, part), 12, FrameSettings(float(seconds)))
        for value, seconds in zip(values, times, strict=True)
    ]
    return find_limits([Bracket.from_frames(frames)]).black_dn


@pytest.mark.parametrize(
    ("values", "part", "black"),
    [
        ((500, 500, 500), 0.06, 500), ((500, 531, 520), 0.06, 531), ((500, 532, 520), 0.06, 0),
        ((500, 500, 500), 0.051, 500), ((500, 500, 500), 0.047, 0),
    ],
)  # fmt: skip
def test_fog_is_a_large_peak_that_hardly_moves(values, part, black):
    """5 % of the pixels, within a 128th of full scale; the highest is taken."""
    assert black_of([*values, 1200, 1800, 2600], 2.0 ** np.arange(6), part) == black


@pytest.mark.parametrize(("third", "black"), [(3.0, 500), (2.9, 0)])
def test_three_frames_that_grow_threefold_show_fog(third, black):
    """The commonest value of the three shortest, where their exposures grow threefold; of five frames none is fog."""
    assert black_of([500] * 3 + [3500] * 3, (1.0, 2.0, third, 10.0, 20.0, 30.0)) == black
    assert black_of([500] * 2 + [3500] * 3, (1.0, 2.0, 10.0, 20.0, 30.0)) == 0
    assert black_of([2100] * 3 + [1900] * 3, (1.0, 2.0, 3.0, 10.0, 20.0, 30.0)) == 0  # a bright value is no black


@pytest.mark.parametrize("wrong", [0, 2, 13, 15])
@pytest.mark.parametrize("ratio", [0.35, 2.9])
def test_fog_is_seen_whatever_one_label_says(wrong, ratio):
    """As many frames as grow threefold by their labels: a wrong one may need one or two frames more."""
    times = 2.0 ** np.arange(16)
    times[wrong] *= ratio
    assert black_of([500] * 6 + [*range(700, 3300, 650)] + [3500] * 6, times) == 500


@pytest.mark.parametrize(
    ("counts", "black_dn"),
    [([80, 10], 0), ([81, 10], 1000), ([8, 1], 0), ([9, 1], 1000), ([500, 400, 10], 1001)],
)
def test_the_lowest_value_is_black_where_it_piles_up(counts, black_dn):
    """Above eight times the mean of the eight values next above it, and with it the next one that does."""
    many = dict(zip(range(1000, 1010), counts + counts[-1:] * 8, strict=False))
    dn = np.repeat([*many, 2000], [*many.values(), 10 - sum(many.values()) % 10])
    found = find_limits([Bracket.from_frames([frame(dn), frame(dn, 2.0)])])
    assert found.black_dn == black_dn


def _frames(power, times=(1.0, 2.0, 4.0, 8.0, 16.0), black_dn=0.0, stated=None, scene=(-6.0, 0.0)):
    """Return frames whose numbers above black are the exposure to a power, read noise of one DN of 12 bits on top."""
    rng = np.random.default_rng(11)
    light = np.exp(rng.uniform(*scene, (60, 80)))
    frames = []
    for time, text in zip(times, stated or times, strict=True):
        dn = black_dn + (4095 - black_dn) * np.minimum(light * time / 4.0, 1.0) ** power
        stored = np.clip(np.rint(dn + rng.normal(0.0, 1.0, light.shape)), 0, 4095).astype(np.uint16)
        frames.append(Frame(stored, 12, FrameSettings(text)))
    return Bracket.from_frames(frames)


@pytest.mark.parametrize(
    ("power", "how", "black_dn", "expected"),
    [
        *((power, {}, 0.0, pytest.approx(power, abs=2e-3)) for power in (1.0, 1.0 / 2.2, 1.3)),
        (1.0, {"black_dn": 300.0}, 300.0, pytest.approx(1.0, abs=2e-3)),
        (1.0, {"black_dn": 300.0}, 0.0, pytest.approx(0.7, abs=0.2)),  # from 0 a line seems to grow more slowly
        (1.0, {"stated": (1.0, 2.0, 2.5, 8.0, 16.0)}, 0.0, pytest.approx(1.0, abs=2e-3)),  # moves two of four pairs
        (1.0, {"times": (1.0, 1.1)}, 0.0, None),  # nearer than a factor of 1.2
        (1.0, {"times": (1.0, 64.0)}, 0.0, None),  # no pixel between black and white in both
        (1.0, {"times": (1.0, 2.0), "scene": (3.0, 4.0)}, 0.0, None),
    ],
)
def test_numbers_above_black_grow_by_the_power_they_were_made_with(power, how, black_dn, expected):
    """Ratios of thousands of pixels of 400 DN and more, each to 0.3 %, give the power to well under 0.002, or None."""
    assert growth_power(_frames(power, **how), black_dn) == expected
