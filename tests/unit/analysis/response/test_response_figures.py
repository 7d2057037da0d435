"""Figures that stand beside a curve, by samples made by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from radiometer.analysis.response import debevec1997 as debevec
from radiometer.analysis.response import robertson1999 as robertson
from radiometer.analysis.response.basis import ValueBasis
from radiometer.analysis.response.compare import compare_methods
from radiometer.analysis.response.curves import _determined
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.jackknife import jackknife
from radiometer.analysis.response.labels import _longest_rise
from radiometer.analysis.response.left_out import dial_step_dn, follow_no_curve
from radiometer.analysis.response.limits import ValueLimits, find_limits
from radiometer.analysis.response.mitsunaga1999 import _curve
from radiometer.analysis.response.pixel_noise import _of_residuals
from radiometer.analysis.response.samples import _edge_scatter, _label_groups, gather_samples
from radiometer.analysis.response.unseen import unseen_factor
from radiometer.analysis.response.weights import group_residual, slope_at, value_at
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve


@pytest.fixture(scope="module")
def samples():
    """Return samples of a straight line over four exposures."""
    radiance = np.exp(np.random.default_rng(1).uniform(-4.0, 0.0, (64, 64)))
    frames = [
        Frame(np.clip(np.round(radiance * t * 250), 0, 255).astype(np.uint8), 8, FrameSettings(float(t)))
        for t in (0.5, 1.0, 2.0, 4.0)
    ]
    return gather_samples(Bracket.from_frames(frames))


def test_a_grouped_jackknife_of_a_mean(samples):
    """s² = (F − 1)/F·Σ(θ_f − θ̄)², widened by (F − 1)/(F − 3), of ten folds."""
    left = []

    def solve(part):
        left.append(np.array([part.dn.mean()]))
        return left[-1]

    found = jackknife(samples, solve)
    values = np.array(left)
    assert len(left) == 10
    assert found == pytest.approx(np.sqrt(0.9 * ((values - values.mean(0)) ** 2).sum(0) * 9 / 7))


def test_residuals_are_from_the_group_s_weighted_mean(samples):
    """ln H − ln t less the weighted mean of the group, and the row's share in it, by a loop."""
    rng = np.random.default_rng(2)
    log_exposure, weight = rng.normal(size=samples.dn.size), rng.uniform(0.5, 2.0, samples.dn.size)
    residual, share = group_residual(samples, log_exposure, weight)
    for group in np.unique(samples.group)[:20]:
        rows = samples.group == group
        light = (log_exposure - samples.log_time)[rows]
        assert residual[rows] == pytest.approx(light - np.average(light, weights=weight[rows]))
        assert share[rows] == pytest.approx(weight[rows] / weight[rows].sum())


def test_the_slope_is_taken_over_a_whole_step(samples):
    """g = ln M: half a stop to either side of M are M·√2 and M/√2: ln 2 over that distance."""
    g = np.log(np.maximum(np.arange(256.0), 0.5))
    found = slope_at(g, np.array([60.0, 100.0]), samples)
    assert found == pytest.approx(np.log(2.0) / (np.array([60.0, 100.0]) * (2**0.5 - 2**-0.5)), rel=2e-3)
    assert value_at(g, np.array([10.5])) == pytest.approx((g[10] + g[11]) / 2)


def test_robertson_s_weight_and_step(samples):
    """Gaussian about the middle, 0 at the ends; a straight line stays, and one bent by a factor moves towards it."""
    limits = samples.limits
    weight = robertson._weight(samples) / samples.pixels
    place = (samples.dn - (limits.black_dn + limits.saturated_dn) / 2) / ((limits.saturated_dn - limits.black_dn) / 2)
    assert weight == pytest.approx(np.exp(-4 * place**2) - np.exp(-4.0) * 0.999, rel=1e-9, abs=1e-12)
    line = np.maximum(np.arange(256.0), 0.5) / 128.0
    same, residual, _ = robertson._iterate(samples, line, 1)
    seen = slice(20, 230)
    assert same[seen] / line[seen] == pytest.approx(1.0, abs=0.02)
    assert residual < 0.03
    bent = line**1.5
    moved, _, _ = robertson._iterate(samples, bent, 3)

    def off(curve):
        return np.std(np.log(curve[seen] / line[seen]))

    assert off(moved) < 0.8 * off(bent)
    assert robertson._log_curve(samples, line)[128] == 0.0


def frames_of(times, black_dn=None, top=250.0):
    radiance = np.exp(np.random.default_rng(1).uniform(-4.0, 0.0, (64, 64)))
    return [
        Frame(
            np.clip(np.round(radiance * t * top), 0, 255).astype(np.uint8),
            8,
            FrameSettings(float(t), black_level_dn=black_dn),
        )
        for t in times
    ]


def test_ratios_of_exposures_stand_in_the_order_of_the_frames():
    """1, 2 and 8 s are ratios of 2 and then of 4, exact as given."""
    found = debevec.recover_response_debevec1997(Bracket.from_frames(frames_of((1.0, 2.0, 8.0))))
    assert found.exposure_ratios == pytest.approx([2.0, 4.0])
    assert found.u_exposure_ratios.tolist() == [0.0, 0.0]


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


@pytest.mark.parametrize(
    ("usual", "ends", "valid"),
    [(0.001, 0.04, (10, 20)), (0.001, 0.06, (12, 18)), (0.02, 0.19, (10, 20)), (0.02, 0.21, (12, 18))],
)
def test_a_curve_ends_where_it_is_no_longer_determined(usual, ends, valid):
    """Beyond 0.05 in ln H, or ten times the usual where that is more; never beyond the data."""
    u = np.full(32, usual)
    u[:12] = u[19:] = ends
    assert _determined(u, (10, 20)) == valid


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


def test_the_longest_rise_lets_small_falls_pass():
    """0.4 % of full scale may be lost to noise; what falls by more belongs to no rise."""

    def rises(*levels):
        level = np.array(levels)
        return np.triu(level[None, :] - level[:, None], 1)

    assert _longest_rise(rises(0.1, 0.2, 0.197, 0.4)) == {0, 1, 2, 3}
    assert _longest_rise(rises(0.1, 0.3, 0.2, 0.4)) in ({0, 1, 3}, {0, 2, 3})
    assert _longest_rise(rises(0.5, 0.1, 0.2, 0.3)) == {1, 2, 3}


def test_a_stated_black_level_is_black():
    """Though nothing piles up there; a fraction counts up."""
    shown = [find_limits([Bracket.from_frames(frames_of((1.0, 2.0), black))]).black_dn for black in (None, 2.5)]
    assert shown[0] < 3
    assert shown[1] == 3


def test_the_noise_of_residuals_is_what_the_mean_leaves(samples):
    """Var(r_i) = v_i·(1 − 2·s_i) + Σs_j²·v_j for a mean of shares s, by drawing."""
    rng = np.random.default_rng(4)
    starts = np.flatnonzero(np.diff(samples.group, prepend=-1))
    rows = np.flatnonzero(samples.group == 0)
    variance = rng.uniform(0.5, 2.0, samples.dn.size)
    weight = rng.uniform(0.5, 2.0, samples.dn.size)
    share = weight / np.add.reduceat(weight, starts)[samples.group]
    found = _of_residuals(samples, variance[:, None], share)[rows, 0]
    drawn = rng.standard_normal((100_000, rows.size)) * np.sqrt(variance[rows])
    residual = drawn - (drawn @ share[rows])[:, None]
    assert found == pytest.approx(residual.var(axis=0), rel=0.03)


def test_pixels_at_edges_scatter_so_many_times_as_much_as_others():
    """Σ dn² / n − (Σ dn / n)² of either, their ratio's median over what is clear of clipping, black and few pixels."""
    rng = np.random.default_rng(6)
    spread = {0: 2.0, 1: 5.0}
    sums = {0: np.zeros((4, 2, 3)), 1: np.zeros((4, 2, 3))}
    expected = []
    for frame in range(2):
        for group in range(3):
            of = {k: 100.0 + 10.0 * group + spread[k] * rng.standard_normal(400) for k in (0, 1)}
            for k, dn in of.items():
                sums[k][:, frame, group] = dn.size, dn.sum(), (dn**2).sum(), 0.0
            expected.append(of[1].var() / of[0].var())
    assert _edge_scatter(sums[0], sums[1]) == pytest.approx(np.median(expected))
    clipped = {k: one.copy() for k, one in sums.items()}
    clipped[1][3, 0] = 1.0  # a pixel of each group of the first frame
    clipped[0][0, 1, 0] = 3.0  # hardly a pixel
    assert _edge_scatter(clipped[0], clipped[1]) == pytest.approx(np.median(expected[4:]))
    clipped[1][3] = 1.0
    assert _edge_scatter(clipped[0], clipped[1]) == 1.0


@pytest.mark.parametrize(("pixels", "groups"), [(640, 64), (768, 64), (1200, 100), (3000, 250), (6144, 384)])
def test_pixels_are_parted_into_groups_of_a_dozen(pixels, groups):
    """A dozen of even brightness to each, but 64 groups of a small picture and 384 of a large one; dark to bright."""
    ramp = np.random.default_rng(7).permutation(pixels).reshape(-1, 8)
    bracket = Bracket.from_frames([Frame(ramp.astype(np.uint16), 16, FrameSettings(1.0))])
    label, count = _label_groups(bracket, ValueLimits(0, 65535))
    size = np.bincount(label)
    assert (count, size.size) == (groups, groups)
    assert size.max() - size.min() <= 1
    assert np.array_equal(label[np.argsort(ramp.ravel())], np.sort(label))


@pytest.mark.parametrize(
    ("lowest_seen", "nothing_below", "first"), [(101, -1, 120), (118, -1, 120), (200, -1, 200), (101, 300, 301)]
)
def test_a_polynomial_ends_where_its_data_end(lowest_seen, nothing_below, first):
    """It is fitted from 2 % of full scale above black and says nothing below, nor of 1e-5 of the highest light."""
    numbers = np.arange(1024.0)
    light = np.where(numbers > 350, (numbers - 100.0) / 900.0, np.where(numbers > nothing_below, 1.2e-5, 0.8e-5))
    samples = SimpleNamespace(dn=np.array([lowest_seen, 1000.0]), limits=ValueLimits(100, 1023), channel="mono")
    curve = _curve(samples, np.log(light), np.full(1024, 0.01), 3)
    assert curve.valid_dn == (first, 1000)
    assert np.all(np.isinf(curve.u_log_exposure[:first]))


@pytest.mark.parametrize(
    ("noise_dn", "error_dn", "told"), [(0.1, 9.6, False), (0.1, 9.9, True), (5.0, 14.8, False), (5.0, 15.2, True)]
)
def test_frames_follow_no_curve_beyond_half_a_third_of_a_stop(noise_dn, error_dn, told):
    """A third of a stop more of 50 and 100 DN on a line is 13 and 26 DN; what is within three sigma is noise."""
    line = np.log(np.maximum(np.arange(256.0), 0.5))
    pixels = np.array([4.0, 25.0])
    samples = SimpleNamespace(dn=np.array([50.0, 100.0]), variance=noise_dn**2 * pixels, pixels=pixels)
    assert dial_step_dn(samples, line) == pytest.approx(75.0 * (2.0 ** (1.0 / 3.0) - 1.0), rel=1e-3)
    assert follow_no_curve(error_dn, samples, line) is told
