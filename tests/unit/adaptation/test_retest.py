"""Limits of agreement of repeated visits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.retest import Compared, compare_visits, limits_of_agreement
from radiometer.adaptation.rod_intercept import InterceptRule
from radiometer.adaptation.threshold_series import ThresholdSeries


def test_limits_are_mean_and_196_standard_deviations() -> None:
    """Differences −1, 0, 1, 2: mean 0.5, standard deviation 1.291; the mean's interval is Student's (t = 3.182)."""
    found = limits_of_agreement(np.array([-1.0, 0.0, 1.0, 2.0]))
    assert (found.mean.value, found.sd) == pytest.approx((0.5, math.sqrt(5 / 3)))
    assert (found.lower.value, found.upper.value) == pytest.approx((0.5 - 2.5303, 0.5 + 2.5303), abs=1e-4)
    assert (found.mean.low, found.mean.high) == pytest.approx((0.5 - 2.0543, 0.5 + 2.0543), abs=1e-3)


@pytest.mark.slow
def test_intervals_of_the_limits_are_one_sided_tolerance_factors() -> None:
    """Bounds of μ + 1.96 σ with 95 % confidence, from ten differences.

    Of 4000 sets of ten the upper limit's interval holds μ + 1.96 σ in 95 % (to 1.4 %).
    """
    rng, held = np.random.default_rng(1), 0
    for row in rng.normal(0.3, 2.0, (4000, 10)):
        bound = limits_of_agreement(row).upper
        held += bound.low <= 0.3 + 1.959964 * 2.0 <= bound.high
    assert held / 4000 == pytest.approx(0.95, abs=0.014)
    unit = np.array([-1.0, 1.0] * 5) * math.sqrt(0.9)  # mean 0, standard deviation 1
    found = limits_of_agreement(unit)
    assert found.upper.high == pytest.approx(-found.lower.low)
    assert found.upper.high > found.upper.value > found.upper.low > 0


def test_one_difference_has_no_limits() -> None:
    """Refused, not divided by zero."""
    with pytest.raises(ValueError, match="two"):
        limits_of_agreement(np.array([1.0]))


def _series(break_min: float, slope: float, seed: int) -> ThresholdSeries:
    times = np.arange(0.3, 20, 0.15)
    cones = -1.5 + 2.5 * np.exp(-times / 1.5)
    rods = -1.5 + slope * (times - break_min)
    noise = np.random.default_rng(seed).normal(0, 0.05, times.size)
    return ThresholdSeries(times, np.where(times > break_min, rods, cones) + noise)


@pytest.mark.slow
def test_shift_between_visits_is_found_in_its_quantity_alone() -> None:
    """Second visits with the break 1 min later: mean difference 1 min, S2 as before; rod intercepts follow."""
    request = FitRequest(bootstrap_draws=0, intercept=InterceptRule(-2.3, 6.5))
    rng = np.random.default_rng(0)
    fits = [
        tuple(
            fit_adaptation(_series(8.0 + 0.3 * n + later, -0.25, 2 * n + round(later)), request, rng)
            for later in (0.0, 1.0)
        )
        for n in range(3)
    ]
    found = {one.name: one for one in compare_visits(fits)}  # type: ignore[arg-type]
    assert set(found) == {"break_min", "s2_slope_per_min", "rod_intercept_min", "plateau"}
    breaks = found["break_min"]
    assert breaks.agreement is not None
    assert breaks.agreement.mean.value == pytest.approx(1.0, abs=4 * breaks.u_fits / math.sqrt(3))
    assert abs(np.diff(found["s2_slope_per_min"].visits, axis=1).mean()) < 0.01
    assert found["rod_intercept_min"].visits[0, 1] - found["rod_intercept_min"].visits[0, 0] == pytest.approx(
        1.0, abs=0.2
    )
    assert compare_visits(fits[:2])[0].agreement is None  # type: ignore[arg-type]


@pytest.mark.slow
def test_pair_without_a_break_is_left_out_and_named() -> None:
    """The second pair's second visit has one branch: its number is reported, its plateau is not compared."""
    times = np.arange(0.3, 20, 0.15)
    flat = ThresholdSeries(times, -1 + 2 * np.exp(-times / 3) + np.random.default_rng(3).normal(0, 0.05, times.size))
    request, rng = FitRequest(bootstrap_draws=0), np.random.default_rng(0)
    broken = [fit_adaptation(_series(9.0, -0.25, seed), request, rng) for seed in (11, 12, 13)]
    found = compare_visits([(broken[0], broken[1]), (broken[2], fit_adaptation(flat, request, rng))])
    assert [(one.name, one.missing, len(one.visits)) for one in found] == [
        ("break_min", (2,), 1),
        ("s2_slope_per_min", (2,), 1),
        ("plateau", (2,), 1),
    ]


@pytest.mark.parametrize("pairs", [2, 3])
def test_json_says_the_limits_where_there_are_enough_pairs(pairs: int) -> None:
    """Of three pairs and more; what is not known, or not a number, is null."""
    agreement = limits_of_agreement(np.array([-1.0, 0.0, 1.0])) if pairs > 2 else None
    shown = Compared("plateau", "log10", np.ones((pairs, 2)), math.nan, (4,), agreement).to_mapping()
    assert (shown["pairs"], shown["pairs_without_it"], shown["u_difference_of_the_fits"]) == (pairs, [4], None)
    if agreement is None:
        assert shown["agreement"] is None
    else:
        assert shown["agreement"] == agreement.to_mapping()
        assert shown["agreement"] != {}
