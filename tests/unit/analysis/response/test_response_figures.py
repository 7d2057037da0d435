"""Figures that stand beside a curve, by samples made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response import robertson1999 as robertson
from radiometer.analysis.response.jackknife import jackknife
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.weights import group_residual, slope_at, value_at
from radiometer.data import Bracket, Frame, FrameSettings


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
