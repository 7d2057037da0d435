"""Fits behind the curves against direct solutions, definitions and certified values from outside."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.response.basis import ValueBasis, hat_weight
from radiometer.analysis.response.curves import black_of_curve, finished_curve, rising, u_with_extrapolation
from radiometer.analysis.response.estimate import inner_range, median_uncertainty, spread_rms
from radiometer.analysis.response.fit import eliminate_groups, fit_response, information, solve_penalised
from radiometer.analysis.response.limits import ValueLimits
from radiometer.analysis.response.noise import LogNoise, dn_at, fit_log_noise, mean_exposure_dn
from radiometer.data import ResponseCurve
from radiometer.data.provenance import Provenance
from radiometer.errors import MeasurementError
from testing.golden.nist_linear import LONGLEY, NORRIS

seeds = st.integers(0, 10**6)

noises = st.tuples(st.floats(1e-6, 1e-2), st.floats(1e-8, 1e-4), st.floats(0.0, 2.0), st.floats(0.0, 0.5))

quick = settings(max_examples=30, deadline=None)

LIMITS = ValueLimits(0, 255)


@pytest.mark.parametrize("problem", [NORRIS, LONGLEY], ids=["norris", "longley"])
def test_certified_regressions_come_out(problem):
    """One group is an intercept: slopes and residual variance are NIST's, to the digits that doubles allow."""
    x = np.array(problem.x)
    # A column of noughts for the gauge to pin; it is not of the problem.
    design = np.column_stack([x, np.zeros(len(x))])
    target, one = np.array(problem.y), np.ones(len(x))
    normal = eliminate_groups(sp.csr_array(design), target, one, np.zeros(len(x), np.intp))
    pinned = np.zeros(design.shape[1])
    pinned[-1] = 1.0
    found = solve_penalised(normal, np.eye(pinned.size), pinned, 0.0)
    assert found.coefficients[:-1] == pytest.approx(problem.slopes, rel=problem.digits)
    freedom = len(x) - len(problem.slopes) - 1
    residual = normal.residuals(found.coefficients)
    assert math.sqrt(residual @ residual / freedom) == pytest.approx(problem.residual_sd, rel=problem.digits)
    assert normal.freedom == len(x) - 1
    variance = np.diag(found.inverse)[:-1] * (residual @ residual) / freedom
    assert np.sqrt(variance) == pytest.approx(problem.slope_sds, rel=1e-4)


def problem_of(seed, groups=6, rows=5, size=4):
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(groups), rows)
    design = rng.normal(size=(group.size, size))
    weight = rng.uniform(0.1, 5.0, group.size)
    return design, rng.normal(size=group.size), weight, group, rng


@quick
@given(seeds)
def test_eliminating_a_group_is_solving_for_it(seed):
    """Curve, residuals and the sum of squares are those of the whole system with a column for each group."""
    design, target, weight, group, rng = problem_of(seed)
    normal = eliminate_groups(sp.csr_array(design), target, weight, group)
    whole = np.hstack([design, -np.eye(group.max() + 1)[group]])
    root = np.sqrt(weight)[:, None]
    direct = np.linalg.lstsq(root * whole, root[:, 0] * target, rcond=None)[0]
    assert np.linalg.solve(normal.matrix, normal.right) == pytest.approx(direct[:4], rel=1e-8, abs=1e-8)
    assert normal.residuals(direct[:4]) == pytest.approx(target - whole @ direct, rel=1e-7, abs=1e-8)
    alone = np.linalg.lstsq(root * whole[:, 4:], root[:, 0] * target, rcond=None)[0]
    left = target - whole[:, 4:] @ alone
    assert normal.square == pytest.approx(weight @ left**2)
    assert normal.freedom == target.size - 6
    # The robust covariance of q: outer products of each group's score, by a loop.
    solution = rng.normal(size=4)
    scores = [
        sum(normal.centred[i] * weight[i] * normal.residuals(solution)[i] for i in np.flatnonzero(group == g))
        for g in range(6)
    ]
    assert normal.robust_meat(solution) == pytest.approx(sum(np.outer(s, s) for s in scores) * 6 / 5)


@quick
@given(seeds, st.floats(1e-3, 10.0))
def test_a_penalty_is_rows_more(seed, smoothing):
    """λP adds as many rows of the penalty's root; the gauge b·c = 0 holds; variance and parameters by their traces."""
    design, target, weight, group, rng = problem_of(seed)
    bent = np.diff(np.eye(4), 1, axis=0)  # leaves a constant free, which the gauge pins: make N blind to it as well
    design = design - design.mean(axis=1, keepdims=True)
    gauge = rng.uniform(0.5, 1.5, 4)
    normal = eliminate_groups(sp.csr_array(design), target, weight, group)
    found = solve_penalised(normal, bent.T @ bent, gauge, smoothing)
    scale = smoothing * np.trace(normal.matrix) / np.trace(bent.T @ bent)
    rows = np.vstack([np.sqrt(weight)[:, None] * normal.centred, math.sqrt(scale) * bent, 1e4 * gauge[None, :]])
    expected = np.concatenate([np.sqrt(weight) * normal.target, np.zeros(4)])
    assert found.coefficients == pytest.approx(np.linalg.lstsq(rows, expected, rcond=None)[0], rel=1e-5, abs=1e-6)
    assert gauge @ found.coefficients == pytest.approx(0.0, abs=1e-9)
    assert found.effective_parameters == pytest.approx(np.trace(found.inverse @ normal.matrix))
    assert 0.0 < found.effective_parameters < 3.0
    residual = normal.residuals(found.coefficients)
    assert found.residual_variance == pytest.approx(
        weight @ residual**2 / (normal.freedom - found.effective_parameters)
    )
    assert found.smoothing == smoothing


def test_the_chosen_smoothing_follows_the_noise():
    """Restricted likelihood smooths a rough line and lets a clean bend stand; what is undetermined is refused."""
    rng = np.random.default_rng(3)
    place = np.repeat(np.arange(30), 4)
    group = np.sort(rng.integers(0, 12, place.size))
    bent = np.diff(np.eye(30), 2, axis=0)
    gauge = np.eye(30)[15]

    def solved(sigma):
        truth = 0.02 * (np.arange(30) - 15.0) ** 2
        target = truth[place] + rng.normal(size=12)[group] + sigma * rng.normal(size=place.size)
        normal = eliminate_groups(sp.csr_array(np.eye(30)[place]), target, np.ones(place.size), group)
        return solve_penalised(normal, bent.T @ bent, gauge, order=2), truth

    (clean, truth), (rough, _) = solved(1e-3), solved(1.0)
    assert clean.smoothing < rough.smoothing
    assert clean.effective_parameters > rough.effective_parameters
    assert np.abs(clean.coefficients - truth).max() < 0.02
    assert math.sqrt(clean.residual_variance) == pytest.approx(1e-3, rel=0.5)
    assert math.sqrt(rough.residual_variance) == pytest.approx(1.0, rel=0.3)
    empty = eliminate_groups(sp.csr_array(np.zeros((4, 30))), np.zeros(4), np.ones(4), np.zeros(4, np.intp))
    with pytest.raises(MeasurementError):
        solve_penalised(empty, np.zeros((30, 30)), gauge, 0.0)


def test_a_curve_that_meets_every_mean_is_no_reason_for_no_smoothness():
    """As many differences as coefficients, rounding in them: λ stays where the curve is known to 1e-4, not at 0."""
    rng = np.random.default_rng(3)
    place = np.column_stack([np.arange(29), np.arange(1, 30)]).ravel()
    target = np.log1p(place) + 1e-5 * rng.standard_normal(place.size)
    normal = eliminate_groups(sp.csr_array(np.eye(30)[place]), target, np.ones(58), np.repeat(np.arange(29), 2))
    bent = np.diff(np.eye(30), 2, axis=0)
    assert solve_penalised(normal, bent.T @ bent, np.eye(30)[15], order=2).smoothing > 1e-8


@pytest.mark.parametrize("leverage", [0.0, 0.5, 0.8])
def test_noise_is_that_before_the_fit_took_up_its_part(leverage):
    """Residuals of a fit that took up a part h of the noise are √(1 − h) of it; what comes out is the noise itself."""
    rng = np.random.default_rng(11)
    g, pixels = rng.uniform(-4.0, 0.0, 6000), np.full(6000, 10.0)
    slope = np.full(6000, 1e-4)
    truth = 1e-2 * np.exp(-g) / pixels
    residual = np.sqrt((1.0 - leverage) * truth) * rng.standard_normal(6000)
    found = fit_log_noise(residual, np.full(6000, leverage), g, slope, pixels).variance(g, slope, pixels)
    assert np.median(found / truth) == pytest.approx(1.0, abs=0.06)


@quick
@given(st.integers(0, 100), st.integers(150, 255), st.floats(0.0, 255.0))
def test_the_hat_is_one_in_the_middle_and_nought_at_the_ends(low, high, dn):
    """Straight on both sides, symmetric, 0 outside."""
    limits = ValueLimits(low, high)
    middle, half = (low + high) / 2, (high - low) / 2
    found = float(hat_weight(np.array([dn]), limits)[0])
    assert found == pytest.approx(max(0.0, 1.0 - abs(dn - middle) / half), abs=1e-12)


@quick
@given(seeds, st.sampled_from([8, 10, 12]))
def test_the_basis_is_a_partition_of_one_that_bends_with_the_logarithm(seed, bits):
    """Splines add up to 1 at any number; third differences of a parabola over u are not penalised."""
    top = (1 << bits) - 1
    basis = ValueBasis(bits, ValueLimits(0, top))
    dn = np.random.default_rng(seed).uniform(0, top, 20)
    assert basis.design(dn).toarray().sum(axis=1) == pytest.approx(1.0)
    k = np.arange(basis.size)
    for smooth in (np.ones(k.size), 1.0 * k, k**2 / 100.0):
        assert smooth @ basis.roughness() @ smooth == pytest.approx(0.0, abs=1e-6)
    wave = (-1.0) ** k
    assert wave @ basis.roughness() @ wave == pytest.approx(64.0 * (k.size - 3))
    # A linear coefficient is the stretched coordinate itself: ln[(M + a)/(top − M + a)], odd about the middle.
    line = basis.design(np.array([0.25 * top, 0.5 * top, 0.75 * top])).toarray() @ k
    assert line[2] - line[1] == pytest.approx(line[1] - line[0])
    softening = max(1.0, top / 1024)
    whole = 2 * math.log((top + softening) / softening)
    stretched = math.log((0.75 * top + softening) / (0.25 * top + softening))
    assert (line[2] - line[1]) * whole / 112 == pytest.approx(stretched, rel=1e-6)


@quick
@given(noises, st.floats(-5.0, 0.5), st.integers(1, 1000))
def test_the_noise_of_a_group_mean_by_its_parts(noise, g, pixels):
    """a/H + b/H² + (c + 1/12)·g'² over n pixels, and what does not average: d and what rounding leaves."""
    shot, read, digital, common = noise
    slope = 0.01
    found = LogNoise(shot, read, digital, common).variance(np.array([g]), np.array([slope]), np.array([pixels]))[0]
    exposure = math.exp(g)
    before = shot / exposure + read / exposure**2 + digital * slope**2
    wave = min(math.exp(-4 * math.pi**2 * before / slope**2) / (2 * math.pi**2), 1 / 12)
    assert found == pytest.approx((before + slope**2 / 12) / pixels + slope**2 * (common + wave), rel=1e-9)


def test_noise_behind_a_straight_line_moves_no_mean():
    """g = ln M: the mean of M is the M of the mean; g = 2.2·ln M: it lies higher by σ²(γ − 1)/(2M)."""
    dn, variance = np.array([120.0]), np.array([25.0 + 1 / 12])
    grid = np.maximum(np.arange(256.0), 0.5)
    assert mean_exposure_dn(dn, variance, np.log(grid), LIMITS) == pytest.approx(dn, abs=0.003)
    shifted = mean_exposure_dn(dn, variance, 2.2 * np.log(grid), LIMITS)
    assert shifted - dn == pytest.approx(25.0 * 1.2 / (2 * 120.0), rel=0.02)
    assert mean_exposure_dn(dn, np.array([1 / 24]), 2.2 * np.log(grid), LIMITS) == pytest.approx(dn)


@quick
@given(seeds, st.integers(5, 60), st.integers(190, 250))
def test_a_finished_curve_never_falls_and_owns_up_to_its_ends(seed, low, high):
    """Gauge 0 in the middle, monotonic, u infinite outside the data and never below what was levelled."""
    rng = np.random.default_rng(seed)
    noise = 0.02 * rng.normal(size=256)
    noise[low : low + 9], noise[high - 30 : high + 1] = 0.0, 0.0  # an end that has to be levelled is left out
    g = np.log(np.arange(256) + 1.0) + noise
    u = np.full(256, 0.01)
    curve = finished_curve(g, u, (low, high), method="m", channel="mono")
    assert np.all(np.diff(curve.log_exposure) >= 0)
    assert curve.log_exposure[128] == 0.0
    assert curve.valid_dn == (low, high)
    inside = slice(low, high + 1)
    assert np.all(np.isinf(curve.u_log_exposure[:low]))
    assert np.all(np.isinf(curve.u_log_exposure[high + 1 :]))
    level = rising(g, u, (low, high))
    assert curve.u_log_exposure[inside] == pytest.approx(np.hypot(0.01, (level - g)[inside]))
    assert level[inside].mean() == pytest.approx(g[inside].mean())  # levelling with equal weights keeps the mean
    over_ln_dn = np.diff(level) / np.diff(np.log(np.maximum(np.arange(256.0), 0.5)))  # outside: powers of M
    assert over_ln_dn[:low] == pytest.approx(over_ln_dn[0], abs=1e-9)
    assert over_ln_dn[high:] == pytest.approx(over_ln_dn[-1], abs=1e-9)
    assert over_ln_dn[-1] <= (level[high] - level[high - 4]) / np.log(high / (high - 4)) + 1e-8  # the last of the data
    whole = u_with_extrapolation(curve)
    for dn, edge in ((0, low), (255, high)):
        step = curve.log_exposure[dn] - curve.log_exposure[edge]
        assert whole[dn] == pytest.approx(math.hypot(step, curve.u_log_exposure[edge]))
    assert np.array_equal(whole[inside], curve.u_log_exposure[inside])


def test_a_curve_falls_to_its_black_by_the_power_that_it_ends_with():
    """H ∝ (M − 13)^0.5 goes on outside the data as itself; 13 DN and less stand half a number above black."""
    signal = np.maximum(np.arange(256.0) - 13.0, 0.5)
    g = 0.5 * np.log(signal)
    damaged = np.where((np.arange(256) < 20) | (np.arange(256) > 240), 7.0, g)
    assert rising(damaged, np.full(256, 0.01), (20, 240), 13) == pytest.approx(g, abs=1e-9)


def test_no_light_is_predicted_as_black_not_as_zero():
    """Fog at 13 DN: what less light than the curve knows gives is 13, elsewhere the inverse of g."""
    g = 0.5 * np.log(np.maximum(np.arange(256.0) - 13.0, 0.5))
    assert dn_at(g, np.array([-50.0, g[13], g[100], 50.0])) == pytest.approx([13.0, 13.0, 100.0, 255.0])
    assert dn_at(np.arange(256.0), np.array([-5.0, 3.25])) == pytest.approx([0.0, 3.25])


def test_a_middle_without_data_makes_the_whole_curve_less_certain():
    """The gauge point is extrapolated: the step to it counts everywhere inside."""
    g = np.linspace(0.0, 2.55, 256)
    curve = finished_curve(g, np.full(256, 0.01), (10, 100), method="m", channel="mono")
    step = 0.04 * math.log(128 / 100) / math.log(100 / 96)  # the power of the last four numbers goes on
    assert curve.u_log_exposure[50] == pytest.approx(math.hypot(0.01, step), rel=1e-6)
    stray = np.full(256, 0.01)
    stray[240:] = 0.2
    assert finished_curve(g, stray, (10, 250), method="m", channel="mono").valid_dn == (10, 239)


def test_an_end_where_the_fit_bends_away_from_its_data_is_not_supported():
    """Above 240 the fit is level while it grows less certain, below 20 it is: no number there shows its light."""
    dn = np.arange(256.0)
    g = np.log(np.clip(dn, 20.0, 240.0))
    u = 0.001 + 0.0005 * np.maximum(dn - 235.0, 20.0 - dn).clip(0.0)
    curve = finished_curve(g, u, (5, 250), method="m", channel="mono")
    assert curve.valid_dn == (20, 240)
    assert np.all(np.isinf(curve.u_log_exposure[241:]))
    rising_there = finished_curve(np.log(dn + 1.0), u, (5, 250), method="m", channel="mono")
    assert rising_there.valid_dn == (5, 250)


def test_the_fog_of_frames_stays_with_their_curve():
    """Black is what the curve was made with, 0 where no frame showed any or a file holds no number."""
    g, u = np.log(np.arange(256) + 1.0), np.full(256, 0.01)
    for fog in (14.0, 0.5, 0.0):
        assert black_of_curve(finished_curve(g, u, (20, 250), method="m", channel="mono", black_dn=fog)) == fog
    for text in ("14", None, [14.0]):
        assert black_of_curve(ResponseCurve(g, u, provenance=Provenance("m", parameters={"black_dn": text}))) == 0.0
    assert black_of_curve(ResponseCurve(g, u)) == 0.0


def test_figures_of_the_diagnostics():
    """5 to 95 % of the range; the median u there; the parts' distance from their mean, scaled to one part."""
    assert inner_range((0, 100)) == slice(5, 96)
    assert inner_range((10, 210)) == slice(20, 201)
    u = np.full(256, 9.0)
    u[20:201] = np.linspace(0.1, 0.3, 181)
    curve = ResponseCurve(np.linspace(0, 1, 256), u, valid_dn=(10, 210))
    assert median_uncertainty(curve) == pytest.approx(0.2)
    shape = np.array([1.0, -1.0])
    assert spread_rms([shape, -shape, shape, -shape]) == pytest.approx(3.0)
    assert spread_rms([shape + 5, shape - 5]) == pytest.approx(0.0)


TIMES = (0.5, 1.0, 2.0, 4.0)


@pytest.fixture(scope="module")
def fit(samples):
    """Return a fit of a straight line at one smoothing, its times taken as exact."""
    return fit_response(samples, samples.dn, np.full(samples.dn.size, 1e-4), time_spread=0.0, smoothing=1e-3)


def test_a_fit_follows_from_the_noise_s_proportions_alone(samples, fit):
    """Four times the variance: the same curve, four times its covariance, a quarter of χ², the same share of rows."""
    rough = fit_response(samples, samples.dn, np.full(samples.dn.size, 4e-4), time_spread=0.0, smoothing=1e-3)
    assert rough.coefficients == pytest.approx(fit.coefficients, rel=1e-6, abs=1e-9)
    assert rough.inverse == pytest.approx(4.0 * fit.inverse, rel=1e-6, abs=1e-12)
    assert rough.reduced_chi2 == pytest.approx(fit.reduced_chi2 / 4.0, rel=1e-6)
    assert rough.leverage() == pytest.approx(fit.leverage(), rel=1e-6)
    assert rough.covariance() == pytest.approx(fit.covariance(), rel=1e-4, abs=1e-12), (
        "the scatter decides, not its model"
    )


def test_rows_take_up_as_much_as_there_are_unknowns(fit):
    """The leverages add up to groups and effective parameters, none above the bound; χ² is over what is left."""
    parameters = float(np.trace(fit.inverse @ fit.normal.matrix))
    groups = int(fit.normal.group.max()) + 1
    assert fit.leverage().sum() == pytest.approx(groups + parameters, rel=1e-3)
    assert fit.leverage().sum() < groups + parameters
    assert fit.leverage().max() <= 0.95
    chi2 = fit.normal.weight @ fit.normal.residuals(fit.solution) ** 2
    assert fit.reduced_chi2 * (fit.normal.target.size - groups - parameters) == pytest.approx(chi2)


def test_data_and_smoothness_share_the_covariance_between_them(fit):
    """What the data make and what the smoothness decides is all of it, and each is a covariance."""
    by_data = fit.inverse @ fit.normal.matrix @ fit.inverse
    assert by_data + fit.smoothness_covariance() == pytest.approx(fit.inverse, rel=1e-9, abs=1e-15)
    for part in (by_data, fit.smoothness_covariance(), fit.covariance()):
        assert np.linalg.eigvalsh(0.5 * (part + part.T)).min() > -1e-9 * np.trace(fit.inverse)


def test_a_label_known_to_nothing_is_found_and_one_known_exactly_is_kept(samples):
    """A frame whose time is stated 1.2-fold too short: freed it says so, held by other data it is as they say."""
    off = samples.log_time - np.log(1.2) * (samples.frame == 2)
    times = samples.frame_log_time - np.log(1.2) * (np.arange(len(TIMES)) == 2)
    lying = replace(samples, frame_log_time=times, log_time=off)
    variance = np.full(samples.dn.size, 1e-4)

    def result_of(**more):
        found = fit_response(lying, samples.dn, variance, time_spread=0.0, smoothing=1e-3, free=[2], **more)
        return found.log_time_errors

    assert result_of() == pytest.approx([0.0, 0.0, np.log(1.2), 0.0], abs=0.01)
    assert result_of(known=[(0.5, 1e-6)]) == pytest.approx([0.0, 0.0, 0.5, 0.0], abs=1e-4)


@pytest.mark.parametrize("u", [0.0, 1e-9, 1e-3, 0.5])
def test_what_is_known_exactly_counts_as_known_to_a_millionth(u):
    """Information is the inverse of a variance, at most that of rounding."""
    assert information(np.diag([u**2, 0.25])) == pytest.approx(np.diag([max(u, 1e-6) ** -2.0, 4.0]), rel=1e-6)
