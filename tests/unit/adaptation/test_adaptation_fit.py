"""Fits of dark adaptation: branches, the break between them, the report, and bleach by worked numbers."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import radiometer as rm
from radiometer.adaptation import adaptation_fit as rules
from radiometer.adaptation.adaptation_fit import (
    LEAST_DEVIANCE,
    FitRequest,
    convex_sum_of_squares,
    earliest_visible_break,
    fit_adaptation,
)
from radiometer.adaptation.branch_fit import CONE_S2, CONE_S2_S3, MODELS, ONE_BRANCH, BranchFit, fit_model, project
from radiometer.adaptation.intervals import InterceptRule, Interval, percentile_interval, profile_interval
from radiometer.adaptation.protocol import (
    KINETICS,
    bleached_fraction,
    bleached_range,
    pupil_diameter_mm,
    retinal_illuminance_td,
)
from radiometer.adaptation.report import curve_csv, report_html, short
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.data.bleaching_constants import CONE_HALF_BLEACH, CONE_REGENERATION, CONSTANTS
from radiometer.errors import MeasurementError, UsageError
from simulators.observers import eye_kinetics
from testing.golden.dark_adaptation import DARK_THETA, dark_p7

TIMES = np.arange(0.5, 30.0, 0.5)

QUICK = FitRequest(bootstrap_draws=0)


def curve(times, rod_rod=1000000000.0):
    """Return an eye's thresholds: cones to -1 (amplitude 2, 1.6 min), break at 9 min, S2 -0.24, S3 -0.03 per min."""
    found = []
    for time in times:
        if time <= 9.0:
            found.append(-1 + 2 * np.exp(-time / 1.6))
        else:
            fast = min(time, rod_rod) - 9.0
            slow = max(time - rod_rod, 0.0)
            found.append(-1 + 2 * np.exp(-9.0 / 1.6) - 0.24 * fast - 0.03 * slow)
    return np.array(found)


def series(sigma, seed=1, rod_rod=1000000000.0, times=TIMES):
    """Return that eye's thresholds with noise."""
    return ThresholdSeries(times, curve(times, rod_rod) + np.random.default_rng(seed).normal(0, sigma, times.size))


@pytest.mark.slow
def test_seven_parameters_are_chosen_where_there_is_an_s3():
    """AICc takes the full model with S3 present, five parameters without, one branch for cones alone."""
    rng = np.random.default_rng(0)
    with_s3 = fit_adaptation(series(0.08, rod_rod=18.0), QUICK, rng)
    without = fit_adaptation(series(0.08, times=TIMES[TIMES < 20]), QUICK, rng)
    cones = fit_adaptation(series(0.08, times=np.arange(0.25, 8.5, 0.25)), QUICK, rng)
    assert [one.chosen.model for one in (with_s3, without, cones)] == [CONE_S2_S3, CONE_S2, ONE_BRANCH]
    second = with_s3.estimates["rod_rod_break_min"]
    assert abs(second.value - 18.0) < 3 * second.u
    assert not cones.has_break


def test_outliers_hardly_move_the_break():
    """Four wild presses of 1.5 log units shift the break by less than its own interval's half width."""
    clean = series(0.08)
    wild = clean.log_threshold.copy()
    wild[[5, 20, 30, 45]] += 1.5
    before = fit_model(clean, CONE_S2)
    after = fit_model(ThresholdSeries(clean.time_min, wild), CONE_S2)
    half = profile_interval(before, "break_min").high - before.values["break_min"]
    assert abs(after.values["break_min"] - before.values["break_min"]) < half
    assert after.weights[[5, 20, 30, 45]].max() < 0.3


def test_profile_interval_shrinks_with_the_noise():
    """Half the noise gives half the interval (the same draws)."""
    wide = profile_interval(fit_model(series(0.10), CONE_S2), "s2_slope_per_min")
    narrow = profile_interval(fit_model(series(0.05), CONE_S2), "s2_slope_per_min")
    assert (narrow.high - narrow.low) / (wide.high - wide.low) == pytest.approx(0.5, abs=0.05)


def test_a_final_threshold_is_not_extrapolated():
    """S3 that ends at 25 of 35 min: the last thresholds are level, and the final threshold and the area hold that."""
    times = np.arange(0.5, 35.0, 0.5)
    level = MODELS[-1].threshold(times, EYE)
    noisy = ThresholdSeries(times, level + np.random.default_rng(11).normal(0, 0.1, times.size))
    found = fit_adaptation(noisy, FitRequest(bootstrap_draws=30), np.random.default_rng(0))
    for name, truth in (("final_threshold", level[-1]), ("area_log10_min", np.trapezoid(level - level[-1], times))):
        assert found.estimates[name].bootstrap.holds(truth)


@pytest.mark.slow
def test_bootstrap_and_profile_agree():
    """Both intervals of the break have about the same width."""
    found = fit_adaptation(series(0.08), FitRequest(bootstrap_draws=150), np.random.default_rng(3))
    estimate = found.estimates["break_min"]
    ratio = (estimate.bootstrap.high - estimate.bootstrap.low) / (estimate.profile.high - estimate.profile.low)
    assert 0.6 < ratio < 1.5


@pytest.mark.slow
def test_stimulus_uncertainty_widens_levels_and_not_slopes():
    """A scale uncertainty of 0.05 shifts thresholds, leaves slopes, and moves a stated criterion's time by u/|S2|."""
    data = series(0.05)
    plain = fit_adaptation(data, FitRequest(-3.0, 0.0, 60), np.random.default_rng(1)).estimates
    shared = fit_adaptation(data, FitRequest(-3.0, 0.05, 60), np.random.default_rng(1)).estimates
    assert shared["s2_slope_per_min"].u == plain["s2_slope_per_min"].u
    assert shared["plateau"].u == pytest.approx(np.hypot(plain["plateau"].u, 0.05), rel=1e-6)
    moved = 0.05 / abs(plain["s2_slope_per_min"].value)
    assert shared["criterion_min"].u == pytest.approx(np.hypot(plain["criterion_min"].u, moved), rel=1e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full(40, 0.0), "never, or always, pressed"),
        (np.random.default_rng(5).normal(0, 0.3, 40), "no recovery"),
        (np.linspace(2, -3, 5), "too few"),
    ],
)
def test_no_adaptation_is_a_verdict_and_no_fit(values, message):
    """Who never pressed, pressed at random or left gives a clear message."""
    data = ThresholdSeries(np.arange(values.size, dtype=float), values)
    with pytest.raises(MeasurementError, match=message):
        fit_adaptation(data, QUICK, np.random.default_rng(0))
    at_once = ThresholdSeries(np.full(values.size, 5.0), values)
    with pytest.raises(MeasurementError, match="one time"):
        fit_adaptation(at_once, QUICK, np.random.default_rng(0))
    for criterion in (math.nan, 1e308):
        with pytest.raises(UsageError, match="criterion"):
            fit_adaptation(data, replace(QUICK, criterion=criterion), np.random.default_rng(0))


def test_the_bias_of_the_method_is_removed_and_its_uncertainty_counts(tmp_path):
    """Thresholds found 0.08 too low by a method: plateau and end are 0.08 higher and less sure, the break stays."""
    data, found = series(0.05), []
    rows = "".join(f"{t},{level}\n" for t, level in zip(data.time_min, data.log_threshold, strict=True))
    for name, facts in (("bare", ""), ("run", "# method_bias_log10: -0.08\n# u_method_bias_log10: 0.036\n")):
        (tmp_path / f"{name}.csv").write_text(f"{facts}time_min,log10_threshold\n{rows}")
        found.append(rm.adapt_fit(tmp_path / f"{name}.csv", bootstrap=5).fit.estimates)
    bare, run = found
    for name, shift, u in (("plateau", 0.08, 0.036), ("final_threshold", 0.08, 0.036), ("break_min", 0.0, 0.0)):
        assert run[name].value == pytest.approx(bare[name].value + shift, abs=2e-3)
        assert run[name].u == pytest.approx(math.hypot(bare[name].u, u), rel=0.02)


def test_a_criterion_stands_beside_the_rod_intercept_of_the_protocol(tmp_path):
    """The time of a level that was asked for takes no figure away; an interval that leans says so where it is short."""
    data = series(0.05)
    rows = "".join(f"{t},{level}\n" for t, level in zip(data.time_min, data.log_threshold, strict=True))
    (tmp_path / "run.csv").write_text(f"# intercept_criterion_log10: -2.3\ntime_min,log10_threshold\n{rows}")
    fit = rm.adapt_fit(tmp_path / "run.csv", criterion=-2.0, bootstrap=0).fit
    assert {"rod_intercept_min", "criterion_min"} <= set(fit.estimates)
    leaning = replace(fit.estimates["break_min"], value=9.0, profile=Interval(8.0, 9.5))
    assert short(replace(fit, estimates={"break_min": leaning}), "break_min") == "9.00 +0.50 -1.00"
    assert short(replace(fit, estimates={"break_min": replace(leaning, value=8.7)}), "break_min") == "8.70 ± 0.75"


EYE = {
    "plateau": -1.0, "amplitude": 2.0, "tau_min": 1.6, "break_min": 9.0,
    "s2_slope_per_min": -0.24, "rod_rod_break_min": 17.0, "s3_slope_per_min": -0.08,
    "final_from_min": 25.0,
}  # fmt: skip

BRANCH_TIMES = np.linspace(0.5, 30.0, 60)


def branch_series(values, sigma=None, times=BRANCH_TIMES):
    return ThresholdSeries(np.asarray(times, float), np.asarray(values, float), sigma)


def by_hand(t, v):
    """Return the threshold at one time by the three branches in words."""
    cones = v["plateau"] + v["amplitude"] * math.exp(-min(t, v["break_min"]) / v["tau_min"])
    s2 = max(0.0, min(t, v["rod_rod_break_min"]) - v["break_min"])
    return cones + v["s2_slope_per_min"] * s2 + v["s3_slope_per_min"] * max(0.0, t - v["rod_rod_break_min"])


@settings(max_examples=50)
@given(st.floats(0.0, 40.0), st.floats(0.5, 4.0), st.floats(4.0, 15.0), st.floats(1.0, 15.0))
def test_the_three_branches_follow_each_other(t, tau, alpha, more):
    """Cones to the break and then held, S2 to the second break, then S3; the smaller models are its beginnings."""
    v = {**EYE, "tau_min": tau, "break_min": alpha, "rod_rod_break_min": alpha + more}
    time = np.array([t])
    assert CONE_S2_S3.threshold(time, v)[0] == pytest.approx(by_hand(t, v), abs=1e-12)
    if t <= alpha + more:
        assert CONE_S2.threshold(time, v)[0] == pytest.approx(by_hand(t, v), abs=1e-12)
    if t <= alpha:
        assert ONE_BRANCH.threshold(time, v)[0] == pytest.approx(by_hand(t, v), abs=1e-12)
    stacked = CONE_S2_S3.basis(time, np.array([[tau, alpha, alpha + more]] * 3))
    assert stacked.shape == (3, 1, 4)


def test_published_parameters_give_the_published_curve():
    """The seven of `Dark`'s examples, with S3 as change of slope there: equal before the break and beyond the cones."""
    _, two, three, four, five, six, seven = DARK_THETA
    v = dict(zip(("plateau", "amplitude", "tau_min", "s2_slope_per_min", "break_min"), DARK_THETA[:5], strict=True))
    v |= {"rod_rod_break_min": seven, "s3_slope_per_min": four + six}
    time = np.linspace(0.0, 30.0, 301)
    ours, theirs = CONE_S2_S3.threshold(time, v), dark_p7(time, DARK_THETA)
    assert ours[time <= five] == pytest.approx(theirs[time <= five], abs=1e-9)
    assert ours[time > five] == pytest.approx(theirs[time > five], abs=1.1 * two * math.exp(-five / three))


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_a_clean_curve_gives_its_parameters_back(model):
    """Each member on its own curve; the sum of squares is nothing."""
    short = branch_series(model.threshold(BRANCH_TIMES, EYE))
    found = fit_model(short, model)
    assert {name: found.values[name] for name in model.parameters} == pytest.approx(
        {name: EYE[name] for name in model.parameters}, rel=5e-3, abs=2e-3
    )
    assert found.sum_of_squares < 1e-6
    assert found.degrees_of_freedom == 60 - len(model.parameters)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_linear_parts_are_weighted_least_squares(seed):
    """At fixed τ and break: the direct solution, and Σw·r²."""
    rng = np.random.default_rng(seed)
    values, weights = rng.normal(size=60), rng.uniform(0.1, 1.0, 60)
    nonlinear = np.array([1.6, 9.0])
    total, linear = project(BRANCH_TIMES, values, CONE_S2, weights, nonlinear)
    columns = np.column_stack(
        [np.ones(60), np.exp(-np.minimum(BRANCH_TIMES, 9.0) / 1.6), np.maximum(BRANCH_TIMES - 9.0, 0.0)]
    )
    normal = columns.T @ (weights[:, None] * columns)
    expected = np.linalg.solve(normal, columns.T @ (weights * values))
    assert linear == pytest.approx(expected, rel=1e-6, abs=1e-8)
    assert total == pytest.approx(float(weights @ (values - columns @ expected) ** 2))


def test_figures_of_a_fit():
    """σ² = Σw·r²/(ν·c), AICc = n·ln(S/n) + 2k + 2k(k + 1)/(n − k − 1); four times as uncertain counts a sixteenth."""
    values = ONE_BRANCH.threshold(BRANCH_TIMES, EYE) + np.random.default_rng(1).normal(0.0, 0.1, 60)
    fit = fit_model(branch_series(values), ONE_BRANCH)
    c = 1.0 - math.erfc(2.5 / math.sqrt(2.0))
    assert fit.sigma == pytest.approx(math.sqrt(fit.sum_of_squares / (57 * c)))
    assert fit.sigma == pytest.approx(0.1, rel=0.25)
    assert fit.aicc == pytest.approx(60 * math.log(fit.sum_of_squares / 60) + 8 + 40 / 55)
    with pytest.raises(MeasurementError, match="too few"):
        fit_model(branch_series(values[:4], times=BRANCH_TIMES[:4]), ONE_BRANCH)
    sigma = np.where(np.arange(60) % 2, 0.4, 0.1)
    rng = np.random.default_rng(5)
    values = ONE_BRANCH.threshold(BRANCH_TIMES, EYE) + sigma * rng.uniform(-1.0, 1.0, 60)
    found = fit_model(branch_series(values, sigma), ONE_BRANCH)
    assert found.weights == pytest.approx((0.1 / sigma) ** 2)
    assert found.sigma == pytest.approx(0.1 / math.sqrt(3.0), rel=0.3)  # of a threshold of the surer kind


def test_intervals_widen_in_squares_and_cut_equal_tails():
    """±1 with u = 0.5 shared: √(1 + (1.96·0.5)²); 95 % of 0 to 1000 are 25 to 975; what is not finite is left out."""
    found = Interval(-1.0, 3.0).widened(0.5)
    assert (found.low, found.high) == pytest.approx((1 - math.hypot(2, 0.98), 1 + math.hypot(2, 0.98)))
    values = [*map(float, range(1001)), math.inf, math.nan]
    for confidence, ends in ((0.95, (25.0, 975.0)), (0.9, (50.0, 950.0))):
        found = percentile_interval(values, confidence)
        assert (found.low, found.high) == pytest.approx(ends)


@pytest.mark.parametrize(
    ("nonlinear", "allowed"),
    [([1.6, 9.0], True), ([9.1, 9.0], False), ([1.6, 0.4], False), ([1.6, 30.1], False), ([0.2, 9.0], False),
     ([1.6, 9.0, 8.0], False), ([1.6, 9.0, 9.0], False), ([1.6, 9.0, 9.5], True), ([1.6, 9.0, 20.0], True),
     ([1.6, 9.0, 31.0], False), ([58.0], True), ([60.0], False), ([0.3], True), ([0.28], False)],
)  # fmt: skip
def test_breaks_lie_inside_and_in_order(nonlinear, allowed):
    """Time constants are between a hundredth of the test's length and the break, twice the test where there is none."""
    model = MODELS[len(nonlinear) - 1]
    assert model.allowed(BRANCH_TIMES, np.array(nonlinear)) is allowed
    if len(nonlinear) == 1:
        assert model.allowed(BRANCH_TIMES + 10.0, np.array(nonlinear)) is allowed


def fitted(**changes):
    """Return a fit of the five parameters, or of seven where S3 is among the changes."""
    model = CONE_S2_S3 if "s3_slope_per_min" in changes else CONE_S2
    values = {name: EYE[name] for name in model.parameters} | changes
    return BranchFit(model, branch_series(model.threshold(BRANCH_TIMES, values)), values, np.ones(60), 1.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "sense"),
    [
        ({}, True), ({"amplitude": -0.1}, False), ({"s2_slope_per_min": -0.031}, True),
        ({"s2_slope_per_min": -0.029}, False), ({"s2_slope_per_min": -0.59}, True),
        ({"s2_slope_per_min": -0.61}, False),
        ({"s2_slope_per_min": 0.2}, False), ({"break_min": 1.2}, False), ({"break_min": 29.4}, False),
        ({"tau_min": 5.9}, True), ({"tau_min": 6.1}, False), ({"tau_min": 0.4, "amplitude": 8.0}, False),
        ({"tau_min": 0.4, "amplitude": 2.0}, True), ({"tau_min": 0.55, "amplitude": 8.0}, True),
        ({"break_min": 27.0, "s2_slope_per_min": -0.15}, False), ({"break_min": 26.5, "s2_slope_per_min": -0.15}, True),
        ({"s3_slope_per_min": -0.03}, True), ({"s3_slope_per_min": -0.3}, False), ({"s3_slope_per_min": 0.06}, False),
        ({"s3_slope_per_min": 0.04}, True),
    ],
)  # fmt: skip
def test_what_an_eye_can_do(changes, sense):
    """Cones that fall and settle, three thresholds on either side, rods that fall half a unit, S3 above S2."""
    assert rules.makes_sense(fitted(**changes)) is sense


def test_quantities_that_follow_from_a_fit():
    """Last threshold, area above it, and when S2 meets a criterion, prolonged where needed."""
    fit = fitted()
    found = rules.derived_quantities(fit.values, fit, -3.0)
    at_break = -1.0 + 2.0 * math.exp(-9.0 / 1.6)
    assert found["final_threshold"] == pytest.approx(at_break - 0.24 * 21.0)
    assert found["criterion_min"] == pytest.approx(9.0 + (at_break + 3.0) / 0.24)
    cones = 2.0 * 1.6 * (math.exp(-0.5 / 1.6) - math.exp(-9.0 / 1.6)) + (-1.0 - found["final_threshold"]) * 8.5
    assert found["area_log10_min"] == pytest.approx(cones + 0.24 * 21.0**2 / 2, rel=1e-3)
    assert (found["area_from_min"], found["area_to_min"]) == (0.5, 30.0)
    rising = fitted(s2_slope_per_min=0.1)
    assert rules.derived_quantities(rising.values, rising, -3.0)["criterion_min"] == math.inf
    one = {"plateau": -4.0, "amplitude": 3.0, "tau_min": 6.0}
    single = BranchFit(ONE_BRANCH, branch_series(ONE_BRANCH.threshold(BRANCH_TIMES, one)), one, np.ones(60), 1.0, 0.0)
    for criterion, met_min in ((-3.0, 6.0 * math.log(3.0)), (-5.0, math.inf)):
        found = rules.derived_quantities(one, single, criterion)
        assert found["criterion_min"] == pytest.approx(met_min)


BREAK_TIMES = np.arange(0.25, 25.0, 0.25)


def rods_alone(times):
    """Return rods after a weak bleach: S2 −0.24 for 6 min, S3 −0.04 for 8 min, then their final level."""
    return -0.24 * np.minimum(times, 6.0) - 0.04 * np.clip(times - 6.0, 0.0, 8.0)


def test_falling_convex_curves_are_met_and_a_quickening_fall_is_not():
    """A hinge at a knot leaves nothing; of −t² on 0..1 the chord by least squares is best: mean square 1/180."""
    weights = np.ones(BREAK_TIMES.size)
    assert convex_sum_of_squares(BREAK_TIMES, np.maximum(10.0 - BREAK_TIMES, 0.0), weights) < 0.02
    fine = np.linspace(0.0, 1.0, 400)
    assert convex_sum_of_squares(fine, -(fine**2), np.ones(400)) / 400 == pytest.approx(1 / 180, rel=0.02)
    level, weights = np.zeros(40), np.ones(40)
    level[20], weights[20] = 5.0, 0.0  # a threshold of no weight bends no curve
    assert convex_sum_of_squares(np.arange(40.0), level, weights) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_rods_alone_have_no_break(seed):
    """S2 that gives way to S3 is no rod–cone break; the verdict says what could have been seen."""
    noise = np.random.default_rng(seed).normal(0, 0.08, BREAK_TIMES.size)
    found = fit_adaptation(
        ThresholdSeries(BREAK_TIMES, rods_alone(BREAK_TIMES) + noise), QUICK, np.random.default_rng(0)
    )
    assert not found.has_break
    assert found.evidence.deviance < LEAST_DEVIANCE
    assert f"a break earlier than {found.evidence.earliest_visible_min:.1f} min cannot be seen" in found.verdict


@pytest.mark.slow
def test_early_break_is_found_where_it_can_be_seen():
    """Cones for 5 min at −1, then rods at −0.24 per min: found, with evidence well beyond what is needed."""
    curve = -1 + 2 * np.exp(-np.minimum(BREAK_TIMES, 5.0) / 1.2) - 0.24 * np.clip(BREAK_TIMES - 5.0, 0.0, 9.0)
    noise = np.random.default_rng(2).normal(0, 0.08, BREAK_TIMES.size)
    found = fit_adaptation(ThresholdSeries(BREAK_TIMES, curve + noise), QUICK, np.random.default_rng(0))
    assert found.estimates["break_min"].value == pytest.approx(5.0, abs=0.6)
    assert found.evidence.deviance > 2 * LEAST_DEVIANCE
    assert earliest_visible_break(BREAK_TIMES, 0.08, 4.0) < 7.0


def test_power_falls_with_scatter_and_with_fewer_thresholds():
    """The earliest break that can be seen comes later with more scatter; with far too much none can."""
    times = [earliest_visible_break(BREAK_TIMES, sigma, 3.0) for sigma in (0.02, 0.08, 0.2)]
    assert times == sorted(times)
    assert times[0] < times[2]
    assert earliest_visible_break(BREAK_TIMES[::4], 0.1, 3.0) > earliest_visible_break(BREAK_TIMES, 0.1, 3.0)
    assert earliest_visible_break(BREAK_TIMES, 3.0, 3.0) is None


# The report of a dark-adaptation fit says the break with its interval, or that none is claimed.


REPORTED_MIN = np.linspace(0.5, 25.0, 45)
TRUE_BREAK_MIN, TRUE_S2 = 9.0, -0.23


def _fit(*, rods=True, facts=None, **request):
    noise = np.random.default_rng(3).normal(0.0, 0.08, REPORTED_MIN.size)
    cones = -1.0 + 2.5 * np.exp(-np.minimum(REPORTED_MIN, TRUE_BREAK_MIN) / 1.6)
    curve = (
        cones + TRUE_S2 * np.maximum(REPORTED_MIN - TRUE_BREAK_MIN, 0.0)
        if rods
        else -4.0 + 3.0 * np.exp(-REPORTED_MIN / 6.0)
    )
    series = ThresholdSeries(REPORTED_MIN, curve + noise, None, facts or {}, ("minutes were taken from seconds",))
    asked = FitRequest(bootstrap_draws=8, **request)
    return fit_adaptation(series, asked, np.random.default_rng(0))


@pytest.fixture(scope="module")
def broken():
    """Return the fit of a curve with a break at 9 min."""
    return _fit()


@pytest.mark.usefixtures("unrendered")
def test_the_break_is_reported_with_its_interval(broken):
    """Break and S2 with half their 95 % intervals, which hold the true ones."""
    page = report_html(broken, "eye")
    text = re.search(
        r"class='outcome'>Rod–cone break at ([\d.]+)\u00a0±\u00a0([\d.]+) min, then S2 of "
        r"−([\d.]+)\u00a0±\u00a0([\d.]+) "
        r"log₁₀ units per min \(95\u00a0% intervals\)\.",
        page,
    )
    time, half, slope, half_slope = map(float, text.groups())
    interval = broken.estimates["break_min"].profile
    assert half == pytest.approx((interval.high - interval.low) / 2, rel=0.05)
    assert abs(time - TRUE_BREAK_MIN) < 1.5 * half
    assert abs(slope + TRUE_S2) < 1.5 * half_slope


@pytest.mark.usefixtures("unrendered")
def test_the_page_names_sources_and_assumptions_and_what_has_none(broken):
    """Final threshold: 0.08 log₁₀ units a decade (Jackson and Owsley 2000); what was taken stands before the tables."""
    page = report_html(broken, "eye")
    for words in (
        "0.08 log₁₀ units higher for each decade", "Jackson and Owsley 2000", "No uncertainty of the stimulus",
        "Rod–cone break and S2 slope: no norm by age is known.",
    ):  # fmt: skip
        assert words in page
    assert "Owsley et al. 2014" not in page
    assert page.index("minutes were taken from seconds") < page.index("<h2>Estimates")
    assert "No uncertainty of the stimulus" not in report_html(_fit(stimulus_u_log10=0.05), "eye")


def test_the_picture_shows_what_the_sentence_claims(broken, monkeypatch):
    """A line at the break, a band over its interval, the plateau, the fitted curve, and after the break cones alone."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda one, stream, **_: figures.append(one) or stream.write(b"<svg/>"))
    report_html(broken, "eye")
    axes, interval = figures[0].axes[0], broken.estimates["break_min"].profile
    assert [(band.get_x(), band.get_width()) for band in axes.patches] == [
        (pytest.approx(interval.low), pytest.approx(interval.high - interval.low))
    ]
    lines = [np.array(line.get_data(), dtype=float) for line in axes.lines]
    assert any(set(x) == {broken.estimates["break_min"].value} for x, _ in lines)
    assert any(set(y) == {broken.chosen.values["plateau"]} for _, y in lines)
    long = [(x, y) for x, y in lines if x.size > REPORTED_MIN.size]
    assert any(y == pytest.approx(broken.chosen.threshold(x)) for x, y in long)
    (later,) = [x for x, y in long if y != pytest.approx(broken.chosen.threshold(x))]
    assert later.min() >= broken.estimates["break_min"].value > later.min() - 1.0


@pytest.mark.slow
def test_the_curve_in_a_file_is_thresholds_and_what_is_left_of_them(broken):
    """A line for each threshold: its time, itself, the curve within the noise of the true one, the rest, its weight."""
    head, *lines = curve_csv(broken).splitlines()
    assert head == "time_min,log10_threshold,fitted,residual,weight"
    time, threshold, fitted, residual, weight = np.array([line.split(",") for line in lines], dtype=float).T
    assert time == pytest.approx(REPORTED_MIN, rel=1e-5)
    assert threshold == pytest.approx(fitted + residual, abs=2e-5)
    truth = -1.0 + 2.5 * np.exp(-np.minimum(REPORTED_MIN, TRUE_BREAK_MIN) / 1.6)
    truth += TRUE_S2 * np.maximum(REPORTED_MIN - TRUE_BREAK_MIN, 0)
    assert np.sqrt(np.mean((fitted - truth) ** 2)) < 0.05
    assert np.std(residual) == pytest.approx(0.08, rel=0.3)
    assert weight.min() > 0.0
    assert weight.max() <= 1.0


@pytest.mark.slow
def test_what_is_not_claimed_says_so():
    """One branch: no break in the sentence's words, and the time from which on one would have been seen."""
    found = _fit(rods=False)
    page = report_html(found, "eye")
    assert not found.has_break
    assert "class='outcome'>No rod–cone break is claimed: one branch, falling to −" in page
    assert f"break after {found.evidence.earliest_visible_min:.1f} min would have been seen" in page
    assert "Rod–cone break at" not in page
    assert "grey is the best curve with a break" in page


@pytest.mark.slow
def test_the_rod_intercept_stands_only_where_its_protocol_has_it(broken):
    """Without the protocol's rule no word of it; with it its time with ± and its limit."""
    assert "intercept" not in report_html(broken, "eye").casefold()
    found = _fit(intercept=InterceptRule(-2.3, 12.3, source="a source", bleach_s=2.5e-4))
    page = report_html(found, "eye")
    met = found.estimates["rod_intercept_min"].value
    assert re.search(f"after {met:.1f} min; [a-z ]+ the limit of 12.3 min \\(a source\\)", page)
    assert re.search(rf"The time is {met:.1f}\d*\u00a0±\u00a0[\d.]+ min \(95\u00a0%\)", page)
    missed = report_html(_fit(intercept=InterceptRule(-7.0, 12.3, source="a source")), "eye")
    assert "not reached within 25.0 min" in missed


# Bleach: kinetics, pupil, trolands against worked numbers.


@pytest.mark.parametrize(
    ("light_td", "seconds", "kind", "before", "bleached"),
    [
        (25_000, 1e5, "rods", 0.0, 0.5),  # at I0 = Q/τ the steady state is one half
        (1e7 / 1e-3, 1e-3, "rods", 0.0, 1 - 1 / math.e),  # a flash of Q, too short for regeneration
        (0.0, 400.0, "rods", 0.9, 0.9 / math.e),
        (0.0, 120.0, "cones", 0.9, 0.9 / math.e),
    ],
)
def test_pigment_bleaches_and_regenerates_by_its_two_constants(light_td, seconds, kind, before, bleached):
    """Q of 10⁷ and 2.4·10⁶ td·s, τ of 400 and 120 s; cones are half bleached at 4.3 log td (Rushton and Henry 1968)."""
    assert bleached_fraction(light_td, seconds, kind, before=before) == pytest.approx(bleached, rel=1e-5)
    assert KINETICS["cones"].td_s / KINETICS["cones"].regeneration_s == pytest.approx(10**4.3, rel=0.01)
    assert KINETICS["cones"].td_s == pytest.approx(2.4e6)


def test_pupil_spans_its_known_range_and_shrinks_with_light():
    """Dark 7.75 mm, 10^6 cd/m² near 2 mm, the old have smaller ones; 300 cd/m² through 4 mm are 3770 td."""
    assert retinal_illuminance_td(300.0, 4.0) == pytest.approx(3769.9, rel=1e-4)
    assert pupil_diameter_mm(0.0) == pytest.approx(7.75)
    assert 2.0 < pupil_diameter_mm(1e6) < 2.3
    assert pupil_diameter_mm(100.0) < pupil_diameter_mm(1.0)
    assert pupil_diameter_mm(0.0, age_years=70) < 6


def test_range_spans_the_published_constants():
    """Rods of 10⁵ td for 600 s are between their published constants; cones between the extremes of I0 with τ."""
    low, high = bleached_range(1e5, 600.0)
    least, most = 1e5 / 1.6e7, 1e5 / 1e7
    assert low == pytest.approx(least / (least + 1 / 360) * (1 - math.exp(-(least + 1 / 360) * 600)))
    assert high == pytest.approx(most / (most + 1 / 450) * (1 - math.exp(-(most + 1 / 450) * 600)))
    assert low < bleached_fraction(1e5, 600.0) <= high
    half, back = CONE_HALF_BLEACH, CONE_REGENERATION
    ends = []
    for half_td in (half.low, half.high):
        for time_s in (back.low, back.high):
            rate = (1.0 + 1e4 / half_td) / time_s
            ends.append(1e4 / (1e4 + half_td) * (1.0 - math.exp(-rate * 60.0)))
    assert bleached_range(1e4, 60.0, "cones") == pytest.approx((min(ends), max(ends)))


def test_calculator_eye_and_docs_share_one_table(project_root):
    """Each value of the table stands in the docs with its spread; the simulated eye bleaches by the same ones."""
    page = (project_root / "docs" / "reference" / "adaptation-test.md").read_text(encoding="utf-8")
    for constant in CONSTANTS:
        assert f"| {constant.name} | {constant.value:g} | {constant.low:g} to {constant.high:g} |" in page
        assert constant.low <= constant.value <= constant.high
    assert KINETICS["cones"].td_s == eye_kinetics.CONE_EXPOSURE_TD_S
    assert KINETICS["cones"].regeneration_s == eye_kinetics.CONE_REGENERATION_S
    assert KINETICS["rods"].td_s == eye_kinetics.ROD_EXPOSURE_TD_S
