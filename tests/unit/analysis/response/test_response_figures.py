"""Figures next to a curve, by samples made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response import debevec1997 as debevec
from radiometer.analysis.response.basis import ValueBasis, unseen_factor
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.limits import ValueLimits, find_limits
from radiometer.analysis.response.methods import compare_methods
from radiometer.analysis.response.noise import group_residual, slope_at, value_at
from radiometer.analysis.response.samples import gather_samples, u_by_groups
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

    found = u_by_groups(samples, solve)
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


def test_a_stated_black_level_is_black():
    """Though nothing piles up there; a fraction counts up."""
    shown = [find_limits([Bracket.from_frames(frames_of((1.0, 2.0), black))]).black_dn for black in (None, 2.5)]
    assert shown[0] < 3
    assert shown[1] == 3
