"""Least squares of reconcile against textbook algebra, and its chances against SciPy's distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, rankdata

from radiometer.reconcile.chances import chi2_beyond, chi2_quantile, ranks
from radiometer.reconcile.fit.linear import LinearFit, RowBlock


def test_parameters_take_up_their_projection_of_many_changes_at_once() -> None:
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


@pytest.mark.parametrize("freedom", [1, 2, 7])
def test_chances_of_chi2(freedom: int) -> None:
    """Tail and quantile are those of SciPy's χ² distribution, far out too."""
    for value in (0.0, 0.3, 5.0, 400.0):
        assert chi2_beyond(value, freedom) == pytest.approx(chi2.sf(value, freedom), rel=1e-12)
    for chance in (0.005, 0.5, 0.995):
        assert chi2_quantile(chance, freedom) == pytest.approx(chi2.ppf(chance, freedom), rel=1e-12)


def test_equal_values_share_their_mean_rank() -> None:
    """Ranks with ties are SciPy's."""
    values = np.array([3.0, 1.0, 3.0, 2.0, 1.0, 1.0])
    assert ranks(values).tolist() == rankdata(values).tolist()
