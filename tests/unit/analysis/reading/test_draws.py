"""Draws of a contribution known by few degrees of freedom: their spread is that of Student's distribution."""

from __future__ import annotations

import math

import pytest

from radiometer.analysis.reading.monte_carlo import Distribution
from radiometer.data import Patch, Quantity, Reading


@pytest.mark.parametrize("u", [0.0, 0.01, 0.0123, 0.0999, 3.0, math.inf])
def test_ends_agree_to_half_of_the_second_digit_of_u(u: float) -> None:
    """Of 0.0123 that is 0.0005, but never less than a twentieth of u, by which ends of draws scatter; of 0 nothing."""
    reading = Reading(Quantity(5.0, u, "1"), Patch(0, 0, 1, 1), "1", coverage_factor=2.0)
    mapping = Distribution(5.1, u, 5.0 - 2.0 * 0.01, 5.0 + 2.2 * 0.01).to_mapping(reading)
    half_digit = 0.5 * 10.0 ** math.floor(math.log10(u) - 1.0) if 0.0 < u < math.inf else 0.0
    assert mapping["tolerance"] == pytest.approx(max(half_digit, 0.05 * u))
    if u == 0.01:
        assert (mapping["low_differs_by"], mapping["high_differs_by"]) == pytest.approx((0.0, 0.002))
