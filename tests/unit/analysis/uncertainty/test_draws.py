"""Draws of a contribution known by few degrees of freedom: their spread is that of Student's distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.analysis.uncertainty.monte_carlo import Distribution, _student
from radiometer.data import Patch, Quantity, Reading


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


@pytest.mark.parametrize("u", [0.0, 0.01, 0.0123, 0.0999, 3.0, math.inf])
def test_ends_agree_to_half_of_the_second_digit_of_u(u: float) -> None:
    """Of 0.0123 that is 0.0005, but never less than a twentieth of u, by which ends of draws scatter; of 0 nothing."""
    reading = Reading(Quantity(5.0, u, "1"), Patch(0, 0, 1, 1), "1", coverage_factor=2.0)
    told = Distribution(5.1, u, 5.0 - 2.0 * 0.01, 5.0 + 2.2 * 0.01).to_mapping(reading)
    half_digit = 0.5 * 10.0 ** math.floor(math.log10(u) - 1.0) if 0.0 < u < math.inf else 0.0
    assert told["tolerance"] == pytest.approx(max(half_digit, 0.05 * u))
    if u == 0.01:
        assert (told["low_differs_by"], told["high_differs_by"]) == pytest.approx((0.0, 0.002))
