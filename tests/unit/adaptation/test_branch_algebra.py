"""The branch model, its weights and its rules, each by its own formula and on both sides of every bound."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.adaptation import adaptation_fit as rules
from radiometer.adaptation.branch_fit import BranchFit, fit_model, project
from radiometer.adaptation.branch_models import CONE_S2, CONE_S2_S3, MODELS, ONE_BRANCH
from radiometer.adaptation.intervals import Interval, percentile_interval
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.errors import MeasurementError
from testing.golden.dark_adaptation import DARK_THETA, dark_p7

EYE = {
    "plateau": -1.0, "amplitude": 2.0, "tau_min": 1.6, "break_min": 9.0,
    "s2_slope_per_min": -0.24, "rod_rod_break_min": 20.0, "s3_slope_per_min": -0.03,
}  # fmt: skip
TIMES = np.linspace(0.5, 30.0, 60)


def series(values, sigma=None, times=TIMES):
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
    short = series(model.threshold(TIMES, EYE))
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
    total, linear = project(TIMES, values, CONE_S2, weights, nonlinear)
    columns = np.column_stack([np.ones(60), np.exp(-np.minimum(TIMES, 9.0) / 1.6), np.maximum(TIMES - 9.0, 0.0)])
    normal = columns.T @ (weights[:, None] * columns)
    expected = np.linalg.solve(normal, columns.T @ (weights * values))
    assert linear == pytest.approx(expected, rel=1e-6, abs=1e-8)
    assert total == pytest.approx(float(weights @ (values - columns @ expected) ** 2))


def test_figures_of_a_fit():
    """σ² = Σw·r²/(ν·c), c what Huber's weights leave; AICc = n·ln(S/n) + 2k + 2k(k + 1)/(n − k − 1)."""
    values = ONE_BRANCH.threshold(TIMES, EYE) + np.random.default_rng(1).normal(0.0, 0.1, 60)
    fit = fit_model(series(values), ONE_BRANCH)
    c = 1.0 - math.erfc(2.5 / math.sqrt(2.0))
    assert fit.sigma == pytest.approx(math.sqrt(fit.sum_of_squares / (57 * c)))
    assert fit.sigma == pytest.approx(0.1, rel=0.25)
    assert fit.aicc == pytest.approx(60 * math.log(fit.sum_of_squares / 60) + 8 + 40 / 55)
    with pytest.raises(MeasurementError, match="too few"):
        fit_model(series(values[:4], times=TIMES[:4]), ONE_BRANCH)


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
     ([1.6, 9.0, 31.0], False), ([58.0], True), ([60.0], False)],
)  # fmt: skip
def test_breaks_lie_inside_and_in_order(nonlinear, allowed):
    """Time constants between a hundredth of the test and the break (twice the test where there is none)."""
    model = MODELS[len(nonlinear) - 1]
    assert model.allowed(TIMES, np.array(nonlinear)) is allowed


@pytest.mark.parametrize(("tau", "allowed"), [(19.0, True), (21.0, False), (0.2, True), (0.05, False)])
def test_a_time_constant_is_bounded_by_the_length_of_the_test(tau, allowed):
    """From minute 10 to minute 20 it is 0.1 to 20 min, whenever the test began."""
    assert ONE_BRANCH.allowed(np.linspace(10.0, 20.0, 40), np.array([tau])) is allowed


def test_a_fit_keeps_what_each_threshold_is_known_to():
    """Where no press is wild the weights are those of the stated σ: four times as uncertain counts a sixteenth."""
    sigma = np.where(np.arange(60) % 2, 0.4, 0.1)
    rng = np.random.default_rng(5)
    values = ONE_BRANCH.threshold(TIMES, EYE) + sigma * rng.uniform(-1.0, 1.0, 60)
    found = fit_model(series(values, sigma), ONE_BRANCH)
    assert found.weights == pytest.approx((0.1 / sigma) ** 2)
    assert found.sigma == pytest.approx(0.1 / math.sqrt(3.0), rel=0.3)  # of a threshold of the surer kind


def fitted(**changes):
    """Return a fit of the five parameters, or of seven where S3 is among the changes."""
    model = CONE_S2_S3 if "s3_slope_per_min" in changes else CONE_S2
    values = {name: EYE[name] for name in model.parameters} | changes
    return BranchFit(model, series(model.threshold(TIMES, values)), values, np.ones(60), 1.0, 0.0)


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
    single = BranchFit(ONE_BRANCH, series(ONE_BRANCH.threshold(TIMES, one)), one, np.ones(60), 1.0, 0.0)
    for criterion, met_min in ((-3.0, 6.0 * math.log(3.0)), (-5.0, math.inf)):
        found = rules.derived_quantities(one, single, criterion)
        assert found["criterion_min"] == pytest.approx(met_min)
