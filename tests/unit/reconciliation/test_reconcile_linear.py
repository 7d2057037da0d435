"""Least squares of reconcile against textbook algebra, and its chances against SciPy's distributions."""

import numpy as np
import pytest
from scipy.stats import chi2, rankdata

from radiometer.reconciliation.fit.linear import LinearFit, RowBlock
from radiometer.statistics.chances import (
    chi2_beyond,
    chi2_quantile,
    deviances,
    followed_scores,
    frames_counted,
    log_bias,
    log_variance,
    normal_score,
    ranks,
    score_slope,
    sine_freedom,
)


def test_parameters_take_up_their_projection_of_many_changes_at_once():
    """Followers move by F·(NᵀN)⁻¹·Nᵀ·v, also in rows that N has too; what J takes up is the projection on it."""
    rng = np.random.default_rng(9)
    nuisances, followers, effects = (rng.standard_normal((40, n)) for n in (5, 5, 2))
    nuisances[20:35], followers[:15] = 0.0, 0.0
    vectors = rng.standard_normal((40, 3))
    fit = LinearFit(rng.standard_normal(40), RowBlock.of(nuisances), effects, RowBlock.of(followers))

    followed, half = fit.followed_with_half(vectors)

    step = np.linalg.lstsq(nuisances, vectors, rcond=None)[0]
    assert followed == pytest.approx(vectors - followers @ step, abs=1e-9)
    jacobian = np.hstack([nuisances, effects])
    taken = jacobian @ np.linalg.lstsq(jacobian, followed, rcond=None)[0]
    assert np.sum(half**2, axis=0) == pytest.approx(np.sum(taken**2, axis=0), rel=1e-9)


def test_a_fit_within_some_rows_is_that_of_vectors_which_are_zero_elsewhere():
    """Rows in another order, those of the followers among them: what follows and what is taken up is the same."""
    rng = np.random.default_rng(11)
    nuisances, followers, effects = (rng.standard_normal((40, n)) for n in (5, 5, 2))
    nuisances[20:35], followers[:30] = 0.0, 0.0
    fit = LinearFit(rng.standard_normal(40), RowBlock.of(nuisances), effects, RowBlock.of(followers))
    rows = np.concatenate([np.arange(30, 40), np.arange(3, 9), np.arange(22, 27)])
    vectors = np.zeros((40, 3))
    vectors[rows] = rng.standard_normal((rows.size, 3))

    whole, part = fit.followed_with_half(vectors)
    within = fit.within(rows)
    own, half = within.followed_with_half(vectors[rows])

    assert own == pytest.approx(whole[rows], abs=1e-12)
    assert half == pytest.approx(part, abs=1e-12)
    assert within.residual.tolist() == fit.residual[rows].tolist()
    assert not whole[np.setdiff1d(np.arange(40), rows)].any()


@pytest.mark.parametrize("freedom", [1, 2, 7])
def test_chances_of_chi2(freedom):
    """Tail and quantile are those of SciPy's χ² distribution, far out too."""
    for value in (0.0, 0.3, 5.0, 400.0):
        assert chi2_beyond(value, freedom) == pytest.approx(chi2.sf(value, freedom), rel=1e-12)
    for chance in (0.005, 0.5, 0.995):
        assert chi2_quantile(chance, freedom) == pytest.approx(chi2.ppf(chance, freedom), rel=1e-12)


def test_equal_values_share_their_mean_rank():
    """Ranks with ties are SciPy's."""
    values = np.array([3.0, 1.0, 3.0, 2.0, 1.0, 1.0])
    assert ranks(values).tolist() == rankdata(values).tolist()


def of_chi2(function, dof):
    """Return the mean of a function of s² over its own expectation, s² of `dof` degrees of freedom, by quadrature."""
    chance = (np.arange(20_000) + 0.5) / 20_000
    return float(np.mean(function(chi2.ppf(chance, dof) / dof)))


@pytest.mark.parametrize("dof", [2.0, 7.0, 40.0])
def test_scores_and_logarithms_of_a_variance(dof):
    """The score has mean 0 and deviation 1, and falls by its slope per unit of ln; ln s² has its bias and variance."""
    entry = np.array([dof])
    assert of_chi2(lambda r: normal_score(r, entry), dof) == pytest.approx(0.0, abs=2e-3)
    assert of_chi2(lambda r: normal_score(r, entry) ** 2, dof) == pytest.approx(1.0, abs=5e-3)
    step = 1e-3
    slope = of_chi2(lambda r: normal_score(r * np.exp(step), entry) - normal_score(r * np.exp(-step), entry), dof)
    assert score_slope(entry)[0] == pytest.approx(slope / (2 * step), rel=2e-3)
    assert log_bias(entry)[0] == pytest.approx(of_chi2(np.log, dof), abs=2e-3)
    spread = of_chi2(lambda r: np.log(r) ** 2, dof) - of_chi2(np.log, dof) ** 2
    assert log_variance(entry)[0] == pytest.approx(spread, rel=5e-3)


def test_a_score_follows_its_expectation_along_a_straight_line():
    """At the accepted expectation it is the score itself; away from it falls by slope·ln; what is masked is 0."""
    seen, dof, mask = np.array([2.0, 2.0, 5.0]), np.full(3, 9.0), np.array([True, True, False])
    plain = followed_scores(seen, np.full(3, 1.5), None, dof, mask)
    assert plain == pytest.approx([normal_score(np.array([2.0 / 1.5]), dof[:1])[0]] * 2 + [0.0])
    same = followed_scores(seen, np.full(3, 1.5), np.full(3, 1.5), dof, mask)
    assert same == pytest.approx(plain)
    moved = followed_scores(seen, np.full(3, 3.0), np.full(3, 1.5), dof, mask)
    assert (plain - moved)[:2] == pytest.approx(score_slope(dof)[:2] * np.log(2.0))
    found = deviances(np.array([2.0, 4.0, 1.0]), np.array([4.0, 2.0, 1.0]), np.full(3, 3.0), mask)
    assert found == pytest.approx([3.0 * (0.5 + np.log(4.0)), 3.0 * (2.0 + np.log(2.0)), 0.0])


def test_few_frames_of_a_sine():
    """One mean is taken off more than two frames; a sine scatters less than noise does, and nothing of it nothing."""
    assert frames_counted(np.array([1.0, 2.0, 3.0, 10.0])).tolist() == [2.0, 2.0, 2.0, 9.0]
    frames = np.array([11.0])  # ten that count: 2/9 of noise; the whole a sine: less 1.5·(1 − 0.16)/10
    assert sine_freedom(frames, np.zeros(1))[0] == pytest.approx(9.0)
    assert sine_freedom(frames, np.ones(1))[0] == pytest.approx(2.0 / (2.0 / 9.0 - 1.5 * 0.84 / 10.0))
    assert sine_freedom(np.array([2.0]), np.ones(1))[0] == pytest.approx(2.0 / (2.0 - 1.5 * 0.2 / 2.0))
