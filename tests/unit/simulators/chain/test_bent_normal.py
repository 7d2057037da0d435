"""Normal values bent by a power law, against moments that are known in closed form or by draws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simulators.chain.bent_normal import bent_normal


def moments(
    middle: float, sigma: float, power: float, toe: float = 0.0, lift: float = 1.0, black: float = 0.0
) -> tuple[float, ...]:
    """Return mean, variance and slope over a range of 1000."""
    columns = (np.array([value]) for value in (middle, sigma, black, 1000.0))
    return tuple(float(values[0]) for values in bent_normal(*columns, power, toe, lift))


@pytest.mark.parametrize(("middle", "sigma"), [(3.0, 2.0), (30.0, 2.0), (300.0, 2.0), (-300.0, 5.0)])
def test_a_straight_curve_changes_nothing(middle: float, sigma: float) -> None:
    """Power 1: mean, variance and slope stay, whichever nodes are used; black and range drop out."""
    for black in (0.0, 2.5):
        assert moments(middle, sigma, 1.0, black=black) == pytest.approx((middle, sigma**2, 1.0), rel=1e-6)


@pytest.mark.parametrize(("middle", "sigma"), [(200.0, 10.0), (200.0, 2.0), (50.0, 1.0)])
def test_a_square_has_the_moments_of_a_squared_normal_value(middle: float, sigma: float) -> None:
    """y = x²/1000: mean (m² + σ²)/1000, variance (4m²σ² + 2σ⁴)/1000², slope 2m/1000."""
    expected = ((middle**2 + sigma**2) / 1e3, (4.0 * middle**2 * sigma**2 + 2.0 * sigma**4) / 1e6, 2.0 * middle / 1e3)
    assert moments(middle, sigma, 2.0) == pytest.approx(expected, rel=1e-9)
    mirrored = moments(-middle, sigma, 2.0)
    assert mirrored == pytest.approx((-expected[0], expected[1], expected[2]), rel=1e-9)


def test_about_the_corner_a_root_is_that_of_draws() -> None:
    """Mean, variance and slope E[z·g]/σ of a power 0.8 within a sigma of its beginning, to half a per cent."""
    z = np.random.default_rng(4).standard_normal(2_000_000)
    for middle in (0.0, 4.0, 12.0):
        value = middle + 6.0 * z
        bent = 1000.0 * np.copysign(np.abs(value / 1000.0) ** 0.8, value)
        mean, variance, slope = moments(middle + 15.0, 6.0, 0.8, black=15.0)
        assert mean - 15.0 == pytest.approx(bent.mean(), abs=0.005 * bent.std())
        assert variance == pytest.approx(bent.var(), rel=0.005)
        assert slope == pytest.approx(np.mean(z * bent) / 6.0, rel=0.005)


def test_the_straight_beginning_is_exact() -> None:
    """Within the toe, all nodes included, y = lift·x: mean, variance lift²σ² and slope lift to rounding."""
    toe, power = 0.05, 0.5
    lift = toe ** (power - 1.0)
    for middle in (0.0, 5.0, -20.0):
        assert moments(middle, 3.0, power, toe, lift) == pytest.approx((lift * middle, 9.0 * lift**2, lift), rel=1e-12)


def test_at_the_end_of_the_toe_curve_and_line_meet_by_shares() -> None:
    """A value at the toe itself is half line, half root: its mean lies below the root's own by the bend's share."""
    toe, power, sigma = 0.05, 0.5, 2.0
    lift = toe ** (power - 1.0)
    mean, _, slope = moments(50.0, sigma, power, toe, lift)
    turn = (lift - power * toe ** (power - 1.0)) * sigma / math.sqrt(2.0 * math.pi)
    assert mean == pytest.approx(1000.0 * toe**power - turn, abs=0.1 * turn)
    assert slope == pytest.approx(0.5 * (lift + power * toe ** (power - 1.0)), rel=0.02)


def test_many_values_are_each_reported_as_if_alone() -> None:
    """More than are worked on at once, near and far mixed."""
    rng = np.random.default_rng(1)
    middle, sigma = rng.uniform(-20.0, 900.0, 1500), rng.uniform(0.5, 20.0, 1500)
    black, room = np.full(1500, 10.0), np.full(1500, 1000.0)
    together = np.array(bent_normal(middle, sigma, black, room, 0.7, 0.0, 1.0))
    for at in (0, 511, 512, 1499):
        alone = moments(float(middle[at]), float(sigma[at]), 0.7, black=10.0)
        assert together[:, at] == pytest.approx(alone, rel=1e-12)
