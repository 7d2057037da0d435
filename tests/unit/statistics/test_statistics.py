"""Robust scale, jackknife, least squares, restricted likelihood and model choice against known distributions."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from radiometer.statistics.chances import sine_freedom
from radiometer.statistics.least_squares import chi_square, residual, solve
from radiometer.statistics.model_choice import AKAIKE, FIVE_SIGMA, THREE_SIGMA, aicc, is_supported
from radiometer.statistics.scale import (
    MAD_TO_SIGMA,
    MEDIAN_U,
    TWENTIETH_TO_SIGMA,
    common_deviance,
    jackknife_u,
    neighbour_sigma,
    robust_sigma,
    spread_beyond_noise,
)


def test_scales_of_normal_values_are_robust():
    """Factors to their last digit; a tenth of wild values moves the scale by a few per cent."""
    assert pytest.approx(1.0 / norm.ppf(0.75), abs=5e-5) == MAD_TO_SIGMA
    assert pytest.approx(math.sqrt(math.pi / 2.0), abs=5e-5) == MEDIAN_U
    assert pytest.approx(-norm.ppf(0.05), abs=5e-4) == TWENTIETH_TO_SIGMA
    values = np.random.default_rng(1).normal(7.0, 2.0, 10_000)
    assert robust_sigma(values) == pytest.approx(2.0, rel=0.05)
    assert neighbour_sigma(np.diff(values + np.linspace(0.0, 500.0, values.size))) == pytest.approx(2.0, rel=0.05)
    values[:1000] = 1e6
    assert robust_sigma(values) == pytest.approx(2.0, rel=0.2)


def test_scatter_beyond_noise_is_as_uncertain_as_its_square():
    """Restricted likelihood is unbiased with five values."""
    value, u = spread_beyond_noise(8.0, 3.0, 40, may_vary=0.5)
    least = math.sqrt(5.0 - 0.5 - 2.0 * math.sqrt((20.0 + 7.0) * 3.5 / 40.0))
    assert (value, u) == pytest.approx((math.sqrt(5.0), (math.sqrt(5.0) - least) / 2.0))
    assert spread_beyond_noise(2.1, 2.0, 220) == pytest.approx((math.sqrt(0.1), 0.2 / (2.0 * math.sqrt(0.1))))
    assert spread_beyond_noise(1.0, 2.0, 32) == pytest.approx((0.0, math.sqrt(0.5)))
    rng = np.random.default_rng(4)
    grid = np.linspace(0.02, 4.0, 400)
    size, found = np.ones(5), []
    for _ in range(400):
        values = rng.normal(10.0, 1.0, 5)
        found.append(grid[np.argmin(common_deviance(values, size, np.full(5, 1e-9), np.outer(grid, size)))] ** 2)
    assert np.mean(found) == pytest.approx(1.0, abs=3 * math.sqrt(2 / 4 / 400))


def test_means_and_lines_have_their_standard_errors():
    """The jackknife's is s/√n; weighted least squares are the normal equations."""
    values = np.random.default_rng(2).normal(0.0, 1.0, 12)
    left = [np.delete(values, one).mean() for one in range(values.size)]
    expected = values.std(ddof=1) / math.sqrt(values.size)
    assert jackknife_u(left) == pytest.approx(expected, rel=1e-12)
    assert jackknife_u(left, few_parts=True) == pytest.approx(expected * math.sqrt(11 / 9), rel=1e-12)
    assert jackknife_u(left[:1]) == 0.0
    rng = np.random.default_rng(3)
    design, values, weight = rng.normal(size=(20, 3)), rng.normal(size=20), rng.uniform(0.5, 2.0, 20)
    expected = np.linalg.inv(design.T @ (weight[:, None] * design)) @ design.T @ (weight * values)
    np.testing.assert_allclose(solve(design, values, weight), expected, rtol=1e-10)
    rest = residual(design, values)
    np.testing.assert_allclose(design.T @ rest, 0.0, atol=1e-12)
    assert chi_square(design, values) == pytest.approx(rest @ rest)


def test_terms_and_sines_are_supported_by_their_frames():
    """As rarely as stated; excess kurtosis of −1.5 by the square of the share."""
    gains = np.random.default_rng(5).normal(size=20_000) ** 2
    for criterion, rate in ((AKAIKE, 0.157), (THREE_SIGMA, 0.0027), (FIVE_SIGMA, 6e-7)):
        passed = np.mean([is_supported(gain, criterion) for gain in gains])
        assert passed == pytest.approx(rate, abs=4 * math.sqrt(rate / gains.size))
    assert aicc(3.0, 10, 4) == pytest.approx(10 * math.log(0.3) + 2 * 4 * 10 / 5)
    assert aicc(3.0, 5, 4) == math.inf
    frames = np.array([5.0, 41.0])
    none, half, whole = (sine_freedom(frames, np.full(2, share)) for share in (0.0, 0.5, 1.0))
    assert none == pytest.approx(frames - 2.0)  # the first frame does not count
    assert 2.0 / none - 2.0 / half == pytest.approx((2.0 / none - 2.0 / whole) / 4.0)
    assert np.all(whole > none)
