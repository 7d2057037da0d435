"""The linearised fit against the whole system at once, whatever its columns; what scores and covariances come to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, rankdata

from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.linear import Groups, LinearFit, RowBlock, cholesky, leave_one_group_out
from radiometer.reconciliation.localise import Covariate
from radiometer.reconciliation.state import EffectParameters, inverse, prior_residual
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

seeds = st.integers(0, 10**6)
quick = settings(max_examples=30, deadline=None)


def fit_of(seed, rows=40, known=5, effects=2):
    """Return a fit without followers, and its whole Jacobian; half of the nuisances' rows are nought."""
    rng = np.random.default_rng(seed)
    nuisances = rng.standard_normal((rows, known))
    nuisances[rng.permutation(rows)[: rows // 2]] = 0.0
    columns, residual = rng.standard_normal((rows, effects)), rng.standard_normal(rows)
    followers = RowBlock.of(np.zeros((rows, known)))
    fit = LinearFit.of(residual, RowBlock.of(nuisances), columns, followers)
    return fit, np.hstack([nuisances, columns]), residual, rng


@quick
@given(seeds)
def test_step_and_covariance_are_those_of_least_squares(seed):
    """(JᵀJ)⁻¹Jᵀr, its covariance (JᵀJ)⁻¹, and the residual that stays."""
    fit, jacobian, residual, _ = fit_of(seed)
    step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    assert fit.step == pytest.approx(step, rel=1e-6, abs=1e-8)
    assert fit.covariance == pytest.approx(np.linalg.inv(jacobian.T @ jacobian), rel=1e-5, abs=1e-8)
    assert fit.projected == pytest.approx(residual - jacobian @ step, abs=1e-7)
    assert fit.normal == pytest.approx(jacobian.T @ jacobian)
    assert jacobian.T @ fit.projected == pytest.approx(np.zeros(7), abs=1e-6)
    vectors = np.random.default_rng(seed + 1).standard_normal((40, 3))
    assert fit.pull(vectors) == pytest.approx(jacobian.T @ vectors)
    assert fit.pull(vectors[10:25], 10) == pytest.approx(jacobian[10:25].T @ vectors[10:25])


@quick
@given(seeds)
def test_a_step_from_another_point_is_that_of_its_own_residual(seed):
    """Old derivatives and a new residual give the step of least squares of that residual, and what it gains."""
    fit, jacobian, _, rng = fit_of(seed)
    elsewhere = rng.standard_normal(40)
    step = np.linalg.lstsq(jacobian, elsewhere, rcond=None)[0]
    found, promised = fit.step_from(elsewhere)
    assert found == pytest.approx(step, rel=1e-6, abs=1e-8)
    left = elsewhere - jacobian @ step
    assert promised == pytest.approx(elsewhere @ elsewhere - left @ left, rel=1e-6, abs=1e-8)


@quick
@given(seeds, st.integers(0, 20), st.integers(1, 4))
def test_a_score_is_what_more_columns_would_explain(seed, start, terms):
    """χ² of further columns next to the parameters is the fall of the sum of squares when they are fitted too."""
    fit, jacobian, residual, rng = fit_of(seed)
    rows = slice(start, start + 15)
    basis = rng.standard_normal((15, terms))
    chi2, rank = fit.score(rows, basis)
    wide = np.zeros((40, terms))
    wide[rows] = basis

    def left(columns):
        return float(np.sum((residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]) ** 2))

    assert rank == terms
    assert chi2 == pytest.approx(left(jacobian) - left(np.hstack([jacobian, wide])), rel=1e-4, abs=1e-6)
    half = fit.half(fit.pull(basis, start))
    assert fit.score(rows, basis, half) == (pytest.approx(chi2, rel=1e-9), rank)
    assert fit.score(rows, 7.0 * basis)[0] == pytest.approx(chi2, rel=1e-6)
    assert fit.score(rows, np.zeros((15, terms))) == (0.0, 0)


def test_what_explains_nothing_scores_and_predicts_nothing():
    """A column of the fit itself, and one of noughts; next to one of its own that alone counts."""
    fit, jacobian, _, rng = fit_of(3)
    assert fit.score(slice(0, 40), jacobian[:, -1:])[1] == 0
    own = rng.standard_normal((40, 1))
    chi2, rank = fit.score(slice(0, 40), np.hstack([own, jacobian[:, -1:]]))
    assert (chi2, rank) == (pytest.approx(fit.score(slice(0, 40), own)[0], rel=1e-3), 1)
    fit, *_ = fit_of(5)
    group, counts = np.repeat(np.arange(10), 4), np.ones(40, bool)
    idle = LinearFit(fit.residual, fit.nuisances, np.column_stack([fit.effects, np.zeros(40)]), fit.followers)
    without, found = (leave_one_group_out(one, Groups(fit.nuisances, group, counts)) for one in (fit, idle))
    assert found.log_density == pytest.approx(without.log_density, rel=1e-7)
    assert found.chi2 == pytest.approx(without.chi2, rel=1e-7)


@quick
@given(seeds)
def test_more_effects_join_those_before(seed):
    """Extended by columns, and by another residual, it is the fit of all of them."""
    fit, jacobian, _, rng = fit_of(seed)
    more, other = rng.standard_normal((40, 2)), rng.standard_normal(40)
    wider = fit.extended(more, other)
    step = np.linalg.lstsq(np.hstack([jacobian, more]), other, rcond=None)[0]
    assert wider.step == pytest.approx(step, rel=1e-6, abs=1e-8)
    assert fit.extended(more).residual is fit.residual


@quick
@given(seeds)
def test_a_block_keeps_the_rows_that_hold_something(seed):
    """Columns side by side, missing rows nought, priors below: the matrix itself, with nought where nothing stood."""
    rng = np.random.default_rng(seed)
    one, two = rng.standard_normal((30, 2)), rng.standard_normal((30, 3))
    one[3:7], two[3:9], one[12:], two[20:] = 0.0, 0.0, 0.0, 0.0
    priors = rng.standard_normal(5)
    block = RowBlock.of(one).joined_with(RowBlock.of(two), 30, priors)
    whole = np.block([[one, two], [np.diag(priors)]])
    rebuilt = np.zeros_like(whole)
    rebuilt[block.rows] = block.values
    assert np.array_equal(rebuilt, whole)
    assert np.all(np.diff(block.rows) > 0)
    assert block.rows.size == 30 - 4 - 10 + 5
    assert block.columns == 5
    assert block.normal == pytest.approx(whole.T @ whole)
    assert block.times(np.eye(5), 35) == pytest.approx(whole)
    assert block.factor @ block.factor.T == pytest.approx(whole.T @ whole, rel=1e-6)


def test_singular_factors_priors_waves_and_ranks():
    """Two equal columns have a factor; a prior is an observation; the n-th wave has n changes of sign."""
    normal = np.array([[4.0, 4.0], [4.0, 4.0]])
    factor = cholesky(normal)
    assert factor @ factor.T == pytest.approx(normal, rel=1e-9)
    assert factor[0, 1] == 0.0
    prior = np.array([2.0, np.inf])
    assert prior_residual(prior, np.array([6.0, 5.0])).tolist() == [-3.0, 0.0]
    assert inverse(prior).tolist() == [0.5, 0.0]
    basis = Covariate("time_waves", np.linspace(3.0, 9.0, 201)[:, None], per_capture=True, waves=6).basis()
    assert basis.shape == (201, 1, 6)
    assert basis[[0, 100, 200], 0, 0] == pytest.approx([1.0, 0.0, -1.0], abs=1e-12)
    for number, wave in enumerate(basis[:, 0].T, 1):
        assert np.count_nonzero(np.diff(np.sign(wave[np.abs(wave) > 1e-9]))) == number
    values = np.array([3.0, 1.0, 3.0, 2.0, 1.0, 1.0])
    assert ranks(values).tolist() == rankdata(values).tolist()


@quick
@given(seeds, st.sampled_from([(3,) * 12, (1,) * 36, (12, 12, 12), (1, 2, 5, 9, 19)]))
def test_a_group_left_out_is_predicted_by_a_fit_to_the_others(seed, sizes):
    """ln p = −½·eᵀS⁻¹e − ½·ln|S|, S = 1 + J_g·(J_oᵀJ_o)⁻¹·J_gᵀ, by a fit to the other rows; some rows never count."""
    fit, jacobian, residual, _ = fit_of(seed)
    group = np.append(np.repeat(np.arange(len(sizes)), sizes), np.zeros(4, np.intp))
    counts = np.append(np.ones(36, bool), np.zeros(4, bool))
    found = leave_one_group_out(fit, Groups(fit.nuisances, group, counts))
    for number, size in enumerate(sizes):
        mine = counts & (group == number)
        others, own = jacobian[~mine], jacobian[mine]
        error = residual[mine] - own @ np.linalg.lstsq(others, residual[~mine], rcond=None)[0]
        spread = np.eye(size) + own @ np.linalg.inv(others.T @ others) @ own.T
        chi2 = float(error @ np.linalg.solve(spread, error))
        assert found.chi2[number] == pytest.approx(chi2, rel=1e-4, abs=1e-8)
        expected = -0.5 * chi2 - 0.5 * np.linalg.slogdet(spread)[1]
        assert found.log_density[number] == pytest.approx(expected, rel=1e-4, abs=1e-6)
    assert found.count.tolist() == list(sizes)


@pytest.mark.parametrize("kind", whole_catalogue().values(), ids=lambda kind: kind.name)
def test_every_fitted_parameter_has_a_size_by_which_it_moves(kind):
    """A step of the fit is a share of it: of a parameter that all trials begin at nothing it is a size, too."""
    for trial in kind.trials:
        own = EffectParameters.of((kind(**trial),), 4095.0)
        assert (own.scale > 1e-9).all()  # a nanosecond, or less of any other unit, is none


# Chances against SciPy's distributions, and what follows parameters.


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


def test_scores_go_straight_and_few_frames_of_a_sine_tell_less():
    """Slope·ln away from the expectation; a sine scatters less than noise."""
    seen, dof, mask = np.array([2.0, 2.0, 5.0]), np.full(3, 9.0), np.array([True, True, False])
    plain = followed_scores(seen, np.full(3, 1.5), None, dof, mask)
    assert plain == pytest.approx([normal_score(np.array([2.0 / 1.5]), dof[:1])[0]] * 2 + [0.0])
    same = followed_scores(seen, np.full(3, 1.5), np.full(3, 1.5), dof, mask)
    assert same == pytest.approx(plain)
    moved = followed_scores(seen, np.full(3, 3.0), np.full(3, 1.5), dof, mask)
    assert (plain - moved)[:2] == pytest.approx(score_slope(dof)[:2] * np.log(2.0))
    found = deviances(np.array([2.0, 4.0, 1.0]), np.array([4.0, 2.0, 1.0]), np.full(3, 3.0), mask)
    assert found == pytest.approx([3.0 * (0.5 + np.log(4.0)), 3.0 * (2.0 + np.log(2.0)), 0.0])
    assert frames_counted(np.array([1.0, 2.0, 3.0, 10.0])).tolist() == [2.0, 2.0, 2.0, 9.0]
    frames = np.array([11.0])  # ten that count: 2/9 of noise; the whole a sine: less 1.5·(1 − 0.16)/10
    assert sine_freedom(frames, np.zeros(1))[0] == pytest.approx(9.0)
    assert sine_freedom(frames, np.ones(1))[0] == pytest.approx(2.0 / (2.0 / 9.0 - 1.5 * 0.84 / 10.0))
    assert sine_freedom(np.array([2.0]), np.ones(1))[0] == pytest.approx(2.0 / (2.0 - 1.5 * 0.2 / 2.0))


# Priors.
