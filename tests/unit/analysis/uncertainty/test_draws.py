"""Draws of a contribution known by few degrees of freedom: their spread is that of Student's distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.analysis.uncertainty.monte_carlo import _student


@pytest.mark.parametrize(
    ("freedom", "variance"), [(math.inf, 1.0), (10.0, 10.0 / 8.0), (5.0, 5.0 / 3.0), (2.0, 1.0), (1.0, 1.0)]
)
def test_draws_spread_by_their_degrees_of_freedom(freedom: float, variance: float) -> None:
    """ν/(ν − 2) times u²; of two or fewer, where t has no variance, those of a normal distribution; to 4 %."""
    drawn = _student(0.3, freedom, np.random.default_rng(8), 100_000)
    assert drawn.mean() == pytest.approx(0.0, abs=4 * 0.3 * math.sqrt(variance / 100_000))
    assert drawn.var() == pytest.approx(0.09 * variance, rel=0.04)


def test_what_is_certain_draws_nothing() -> None:
    """u of 0 gives 0, whatever the degrees of freedom."""
    assert not _student(0.0, 5.0, np.random.default_rng(8), 10).any()
