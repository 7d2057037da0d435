"""The linearised fit against the whole system at once, whatever its columns; what scores and covariances come to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.fit.linear import Groups, LinearFit, RowBlock, cholesky, leave_one_group_out
from radiometer.reconciliation.fit.state import EffectParameters
from radiometer.reconciliation.search.localise import Covariate

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


def test_what_the_parameters_explain_already_scores_nothing():
    """A column of the fit itself leaves nothing to be tested; next to one of its own, that alone counts."""
    fit, jacobian, _, rng = fit_of(3)
    assert fit.score(slice(0, 40), jacobian[:, -1:])[1] == 0
    own = rng.standard_normal((40, 1))
    chi2, rank = fit.score(slice(0, 40), np.hstack([own, jacobian[:, -1:]]))
    assert (chi2, rank) == (pytest.approx(fit.score(slice(0, 40), own)[0], rel=1e-3), 1)


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


def test_a_ridge_keeps_the_factor_of_a_singular_matrix():
    """Two equal columns have a factor still, right to the ridge."""
    normal = np.array([[4.0, 4.0], [4.0, 4.0]])
    factor = cholesky(normal)
    assert factor @ factor.T == pytest.approx(normal, rel=1e-9)
    assert factor[0, 1] == 0.0


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


def test_an_effect_that_changes_nothing_predicts_nothing():
    """A column of noughts next to others leaves every group's density as it is."""
    fit, *_ = fit_of(5)
    group, counts = np.repeat(np.arange(10), 4), np.ones(40, bool)
    idle = LinearFit(fit.residual, fit.nuisances, np.column_stack([fit.effects, np.zeros(40)]), fit.followers)
    without, found = (leave_one_group_out(one, Groups(fit.nuisances, group, counts)) for one in (fit, idle))
    assert found.log_density == pytest.approx(without.log_density, rel=1e-7)
    assert found.chi2 == pytest.approx(without.chi2, rel=1e-7)


def test_waves_begin_with_half_a_turn():
    """Over an axis from end to end: the first wave falls once from 1 to −1, the n-th has n changes of sign."""
    basis = Covariate("time_waves", np.linspace(3.0, 9.0, 201)[:, None], per_capture=True, waves=6).basis()
    assert basis.shape == (201, 1, 6)
    assert basis[[0, 100, 200], 0, 0] == pytest.approx([1.0, 0.0, -1.0], abs=1e-12)
    for number, wave in enumerate(basis[:, 0].T, 1):
        assert np.count_nonzero(np.diff(np.sign(wave[np.abs(wave) > 1e-9]))) == number


@pytest.mark.parametrize("kind", whole_catalogue().values(), ids=lambda kind: kind.name)
def test_every_fitted_parameter_has_a_size_by_which_it_moves(kind):
    """A step of the fit is a share of it: of a parameter that all trials begin at nothing it is a size, too."""
    for trial in kind.trials:
        own = EffectParameters.of((kind(**trial),), 4095.0)
        assert (own.scale > 1e-9).all()  # a nanosecond, or less of any other unit, is none
