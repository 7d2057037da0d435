"""Laws of the parts of a response: gauges, ratios, thresholds on either side, what is said of a fit."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from radiometer.analysis.response import auto, linear_spline, mitsunaga1999, pixel_noise, predicting, settle
from radiometer.analysis.response import robertson1999 as robertson
from radiometer.analysis.response.displacement import _parts
from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.effective import places_as_one, tones_as_one
from radiometer.analysis.response.estimate import Agreement, compare_thirds
from radiometer.analysis.response.fit import time_error_modes
from radiometer.analysis.response.jackknife import jackknife, jackknife_u
from radiometer.analysis.response.left_out import error_dn
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.methods import METHODS, method_names
from radiometer.analysis.response.noise import LogNoise
from radiometer.analysis.response.noise_shift import mean_exposure_dn
from radiometer.analysis.response.pairs import Gauge, Pairs, with_log_ratios
from radiometer.analysis.response.polynomial import Polynomial
from radiometer.analysis.response.proportion import _power
from radiometer.analysis.response.samples import _edge_scatter, gather_samples
from radiometer.analysis.response.weights import row_variance, slope_at
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve
from radiometer.errors import InputError, MeasurementError, UsageError

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


@pytest.mark.parametrize(
    ("short", "long", "ratio", "power"),
    [
        (0.2, 0.4, 2.0, 1.0), (0.2, 0.2 * 2.0**0.45, 2.0, 0.45), (0.1001, 0.2, 2.0, None), (0.0999, 0.2, 2.0, "none"),
        (0.5, 0.9499, 2.0, None), (0.5, 0.9501, 2.0, "none"), (0.4, 0.5, 1.21, None), (0.4, 0.5, 1.19, "none"),
    ],
)  # fmt: skip
def test_the_power_of_two_frames_is_told_between_a_tenth_and_nineteen_twentieths(short, long, ratio, power):
    """Of numbers clear of both ends, of exposures a fifth apart or more; fifty pixels are the fewest."""
    found = _power(np.full(50, short), np.full(50, long), math.log(ratio))
    assert (found is None) is (power == "none")
    if isinstance(power, float):
        assert found == pytest.approx(power)
    assert _power(np.full(49, short), np.full(49, long), math.log(ratio)) is None


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


def test_the_lattice_of_pixels_has_odd_steps_and_spares_the_rim():
    """Some six thousand pixels; the step shares no factor with blocks of eight; each has neighbours on all sides."""
    for shape in ((480, 640), (64, 64), (2000, 3000), (100, 90)):
        rows, columns = pixel_noise._lattice(shape)
        steps = set(np.diff(rows).tolist()) | set(np.diff(columns).tolist())
        (step,) = steps
        assert step % 2 == 1
        assert (step + 2) ** 2 > shape[0] * shape[1] / 6000 or step == 1
        assert step == 1 or (step - 2) ** 2 < shape[0] * shape[1] / 6000
        assert 1 <= rows[0] <= max(step // 2, 1)
        assert shape[0] - 1 - step <= rows[-1] <= shape[0] - 2
        assert shape[1] - 1 - step <= columns[-1] <= shape[1] - 2


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


def test_amplitudes_at_or_above_nothing_are_those_of_all_rows():
    """As by the whole matrix: free ones are ordinary least squares, what would be negative is 0, alike ones are one."""
    rng = np.random.default_rng(2)
    columns = rng.uniform(0.5, 1.5, (400, 3)) * np.array([1e-6, 1.0, 1e5])
    for truth in (np.array([2e6, 3.0, 1e-5]), np.array([2e6, 0.0, 1e-5])):
        found = pixel_noise._least_squares_above_zero(columns, columns @ truth)
        assert found * [1e-6, 1.0, 1e5] == pytest.approx(truth * [1e-6, 1.0, 1e5], rel=1e-4, abs=1e-4)
    wanted = columns @ np.array([2e7, -1.0, 2e-4])
    found = pixel_noise._least_squares_above_zero(columns, wanted)
    assert found[1] == 0.0
    free = np.linalg.lstsq(columns[:, [0, 2]], wanted, rcond=None)[0]
    assert found[[0, 2]] == pytest.approx(free, rel=1e-4)
    nothing = np.column_stack([columns, np.zeros(400)])
    assert pixel_noise._least_squares_above_zero(nothing, columns @ truth)[:3] == pytest.approx(
        pixel_noise._least_squares_above_zero(columns, columns @ truth)
    )


def test_parts_of_a_picture_are_eighths_each_way():
    """64 parts, numbered by rows; each pixel's rows lie in its own."""
    row, column = (index.ravel() for index in np.indices((16, 24)))
    pixels = SimpleNamespace(row=row, column=column, samples=SimpleNamespace(group=np.arange(row.size)[::-1]))
    found = _parts((16, 24), pixels)[::-1].reshape(16, 24)
    assert np.array_equal(found, np.kron(np.arange(64).reshape(8, 8), np.ones((2, 3), int)))


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
    jackknife(few, lambda part: seen.append(part.group_count) or np.zeros(1))
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


def test_rows_within_a_twentieth_of_the_ends_fade(samples):
    """By the square of their distance, to a millionth of their weight; the middle counts in full, to 1e-4 in ln H."""
    limits = samples.limits
    at = limits.black_dn + (limits.saturated_dn - limits.black_dn) * np.array([0.5, 0.05, 0.025, 0.0])
    rows = SimpleNamespace(limits=limits, pixels=np.full(4, 1e12), frame_log_time=samples.frame_log_time)
    found = row_variance(rows, at, LINE, LogNoise(0.0, 0.0, 10.0, 0.0))
    assert found == pytest.approx(np.array([1e-8, 1e-8, 4e-8, 1e-2]), rel=1e-3)


@pytest.mark.parametrize(
    ("apart", "slope"), [(0.02, 0.1 / (1.0 + 2.0 + 5.0 / 3.0)), (0.2, 0.2 / (1.0 + 7.0 + 10.0 / 3.0))]
)
def test_repeats_of_an_exposure_are_no_step(apart, slope, samples):
    """A curve of 0.01 up to 100 DN and 0.03 beyond, at 101: half a step to either side, and a step is 0.1 at least."""
    near = replace(samples, frame_log_time=apart * np.arange(4.0))
    numbers = np.arange(256.0) - 100.0
    kinked = np.where(numbers > 0.0, 0.03, 0.01) * numbers
    assert slope_at(kinked, np.array([101.0]), near) == pytest.approx([slope], rel=1e-6)


def test_a_polynomial_of_the_first_order_is_a_line():
    """1 + c·(x − x_mid)·2: 1 in the middle, so that g is 0; it rises where c does, and misfits by pairs' ratios."""
    x = np.linspace(0.0, 1.0, 256)
    line = Polynomial(x, np.array([0.5]), np.log([2.0]))
    assert line.values(np.array([128.0, 255.0])) == pytest.approx([1.0, 1.0 + (1.0 - x[128])])
    assert line.log_curve()[128] == 0.0
    pairs = SimpleNamespace(
        shorter=np.array([50.0, 60.0]),
        longer=np.array([100.0, 120.0]),
        pair=np.array([0, 0]),
        sigma=np.array([0.1, 0.2]),
    )
    short, long = line.values(pairs.shorter), line.values(pairs.longer)
    assert line.misfit(pairs) == pytest.approx(np.sum((np.log(2.0 * short / long) / pairs.sigma) ** 2))
    assert line.rises(pairs)
    assert not replace(line, coefficients=np.array([-0.5])).rises(pairs)


@pytest.mark.parametrize(("span", "refused"), [(0.69, True), (0.70, False)])
def test_a_curve_spans_the_smallest_step_of_its_frames_at_least(span, refused):
    """ln 2 = 0.693 between two frames that differ."""
    pairs = SimpleNamespace(nominal_log_ratio=np.log([4.0, 2.0]))
    if refused:
        with pytest.raises(MeasurementError, match="finds no response"):
            mitsunaga1999._refuse_flat(np.array([0.0, span / 2, span]), pairs)
    else:
        mitsunaga1999._refuse_flat(np.array([0.0, span / 2, span]), pairs)


def test_a_polynomial_owns_up_to_what_it_lies_off_beyond_three_sigma():
    """0.05 off a curve known to 0.01 leaves 0.02; within three sigma, or where nothing is known, nothing."""
    first = SimpleNamespace(log_exposure=np.zeros(4), u_log_exposure=np.array([0.01, 0.02, np.inf, 0.01]))
    here = SimpleNamespace(log_curve=lambda: np.array([0.05, 0.05, 9.0, -0.04]))
    found = mitsunaga1999._off_the_first(SimpleNamespace(first=first), here)
    assert found == pytest.approx([0.02, 0.0, 0.0, 0.01])


@pytest.mark.parametrize(
    ("notes", "bound"), [(mitsunaga1999._notes, 0.01), (linear_spline._notes, 0.005)], ids=["polynomial", "spline"]
)
def test_a_method_that_does_not_follow_says_so(notes, bound):
    """From 1 % of residuals on for a polynomial, half a per cent of misfit for a nearly straight line; not at it."""
    assert notes(bound) == ()
    (said,) = notes(1.2 * bound)
    assert f"{100 * 1.2 * bound:.1f} %" in said
    assert "use auto" in said


def test_a_spline_s_misfit_is_what_it_lies_off_the_finer_curve():
    """A step of 0.1 is seen where it is and, by its mean square, around it; at the gauge and outside nothing is."""
    finer = curve(LINE, valid=(10, 240))
    off = LINE.copy()
    off[60:100] += 0.1
    found = linear_spline._misfit(off, finer, (20, 230))
    assert found[60:100] == pytest.approx(np.full(40, 0.1), rel=1e-4)
    width = (230 - 20) // 8
    assert 0.0 < found[58] < 0.1
    assert found[60 - width] == pytest.approx(1e-4)
    assert found[128] == 0.0
    assert found[[12, 235]] == pytest.approx([1e-4, 1e-4])
    assert linear_spline._misfit(LINE + 3.0, finer, (20, 230))[70] == pytest.approx(1e-4)


def test_a_line_s_black_is_the_stated_one_or_that_which_makes_frames_agree(samples):
    """Stated 3 is 3; frames with 6 DN of offset show 6."""
    stated = replace(samples, limits=ValueLimits(3, 255))
    assert linear_spline._black(stated) == 3.0
    shifted = replace(samples, dn=samples.dn + 6.0, limits=ValueLimits(0, 255))
    assert linear_spline._black(shifted) == pytest.approx(6.0, abs=0.3)
    assert linear_spline._spline(samples, np.array([0.0, 77.7, 255.0])).toarray().sum(axis=1) == pytest.approx(1.0)


def test_robertson_s_curve_has_256_nodes_at_most(samples):
    """One for each number at 8 bits, evenly over more; its logarithm is 0 in the middle and straight between nodes."""
    assert np.array_equal(robertson._nodes(samples), np.arange(256.0))
    deep = replace(samples, bit_depth=12)
    nodes = robertson._nodes(deep)
    assert (nodes.size, nodes[-1]) == (256, 4095.0)
    g = robertson._log_curve(deep, np.exp(0.01 * nodes))
    assert g == pytest.approx(0.01 * (np.arange(4096.0) - 2048.0), abs=1e-9)


def test_rivals_that_predict_as_well_are_in_the_doubt():
    """Curves 0.03 and 0.06 off beside the best: the root mean square over all three."""

    def one(off):
        return SimpleNamespace(relative=np.array([0.0, off]))

    judged = predicting.Judged(one(0.0), (one(0.03), one(-0.06)))
    assert judged.u_among(judged.other_smoothness) == pytest.approx([0.0, math.sqrt((0.03**2 + 0.06**2) / 3.0)])
    assert judged.u_among(()) == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(("frames", "folds"), [(3, 3), (8, 8), (9, 8), (20, 8)])
def test_frames_are_left_out_one_by_one_up_to_eight(frames, folds):
    """More fall into eight folds."""
    assert predicting.frame_folds(SimpleNamespace(frame_log_time=np.arange(float(frames)))) == folds


@pytest.mark.parametrize(
    ("stops", "whole"),
    [
        ((0.0, 1.0, 3.0), True), ((0.0, 1.019, 2.0), True), ((0.0, 1.021, 2.0), False), ((2.0, 0.0, 1.0), True),
        ((0.0, 1.0 / 3.0, 2.0), False),
    ],
)  # fmt: skip
def test_whole_stops_are_so_to_a_fiftieth(stops, whole):
    """Whatever the order of the frames; a third of a stop is none."""
    assert auto._at_whole_stops(SimpleNamespace(frame_log_time=math.log(2.0) * np.array(stops))) is whole


def test_what_is_said_of_wrong_labels_and_of_parts_that_disagree():
    """Frames by their label or time; rivals with their ratio; per cents of quadrants and of frames."""
    plain = SimpleNamespace(frame_labels=(), frame_log_time=np.log([0.01, 0.5]))
    named = SimpleNamespace(frame_labels=("1/100 s (a.jpg)", "0.5 s (b.jpg)"), frame_log_time=plain.frame_log_time)
    assert [auto._label(one, 1) for one in (plain, named)] == ["0.5 s", "0.5 s (b.jpg)"]
    label = SimpleNamespace(rivals=((0, 1.2345),))
    assert "changing instead 0.01 s to 1.234 predicts" in auto._rivals(label, plain)
    assert auto._rivals(SimpleNamespace(rivals=()), plain) == ""
    result = SimpleNamespace(samples=SimpleNamespace(dn=np.array([0.0, 255.0])))
    parts = SimpleNamespace(agreement=lambda inner: Agreement(0.012, 0.034))
    said = auto._note_on_disagreement(result, parts)
    assert "one quadrant of the picture differ by 1.2 %" in said
    assert "some of the frames by 3.4 %" in said
    assert "quadrant" not in auto._note_on_disagreement(result, SimpleNamespace(agreement=lambda inner: None))


@pytest.mark.parametrize(("after", "loose"), [((0.8, 0.99), True), ((0.82, 1.0), False), ((0.5, 1.01), False)])
def test_times_are_freed_where_all_quadrants_gain_and_a_tenth_in_all(after, loose, monkeypatch):
    """From 1 and 1: 1.79 is a tenth less; 1.82 is not; one quadrant that loses forbids it."""
    samples = SimpleNamespace(frame_log_time=np.arange(4.0), without_quadrant=(1, 2))
    found = SimpleNamespace(log_exposure=None, choices=SimpleNamespace(free=(), known=()))
    freed = SimpleNamespace(fit=SimpleNamespace(time_spread=0.01))
    monkeypatch.setattr(auto, "settle", lambda *_: freed)
    monkeypatch.setattr(auto, "error_of_quadrants", lambda _, one: np.array((1.0, 1.0) if one is found else after))
    assert (auto._with_times(samples, found) is freed) is loose
    samples.frame_log_time = np.array([0.0, 1.0, 2.0, 2.0])
    assert auto._with_times(samples, found) is found
    samples.frame_log_time, samples.without_quadrant = np.arange(4.0), ()
    assert auto._with_times(samples, found) is found
    samples.without_quadrant, freed.fit.time_spread = (1, 2), 0.0
    assert auto._with_times(samples, found) is found


def test_robertson_s_residual_knows_no_common_factor(samples):
    """A first guess ten times too large is brought to its gauge: frames that agree leave the same residual."""
    line = np.maximum(np.arange(256.0), 0.5) / 128.0
    right, large = (robertson._iterate(samples, factor * line, 1) for factor in (1.0, 10.0))
    assert large[0] == pytest.approx(right[0])
    assert large[1] == pytest.approx(right[1])
    assert (right[1], right[2]) == (pytest.approx(0.015, abs=0.015), 1)


def test_pixels_without_noise_have_that_of_rounding():
    """1/6 DN² at edges beside none on even ground is twice a twelfth; none beside none is no difference."""
    even, edges = (np.zeros((4, 1, 1)) for _ in range(2))
    even[:3, 0, 0] = 100.0, 100.0 * 50.0, 100.0 * 50.0**2
    edges[:3, 0, 0] = 100.0, 100.0 * 50.0, 100.0 * (50.0**2 + 1.0 / 6.0)
    assert _edge_scatter(even, edges) == pytest.approx(2.0)
    assert _edge_scatter(even, even) == 1.0


@pytest.mark.parametrize(
    ("tones", "places", "quadrants", "found"),
    [(2.0, 5.0, 4, 5.0), (7.0, 5.0, 4, 7.0), (2.0, 90.0, 4, 25.0), (2.0, 90.0, 3, 100.0 / 3.0), (2.0, 90.0, 2, 2.0)],
)
def test_groups_count_as_one_by_tones_or_places_but_quadrants_are_their_own(
    tones, places, quadrants, found, monkeypatch
):
    """The larger of both; of 100 groups no more than 100 by the quadrants, of which three at least say something."""
    rows = SimpleNamespace(dn=np.arange(10.0, 20.0), pixels=np.ones(10), group=None, frame=None, group_count=100)
    fit = SimpleNamespace(
        normal=SimpleNamespace(residuals=lambda _: np.zeros(10)), solution=None, leverage=lambda: np.zeros(10),
        covariance=lambda: None,
    )  # fmt: skip
    whole = SimpleNamespace(fit=fit, samples=rows, dn=rows.dn, log_exposure=LINE, u_of=lambda _: np.ones(256))
    stands = {
        "fit_log_noise": lambda *_: None, "slope_at": lambda *_: np.ones(10), "row_variance": lambda *_: np.ones(10),
        "tones_as_one": lambda *_: tones, "places_as_one": lambda *_: places,
        "refit": lambda part, _: SimpleNamespace(relative=part * LINE),
    }  # fmt: skip
    for name, stand in stands.items():
        monkeypatch.setattr(settle, name, stand)
    samples = SimpleNamespace(without_quadrant=np.arange(1.0, 1.0 + quadrants))
    assert settle._inflation(samples, whole) == pytest.approx(found)
