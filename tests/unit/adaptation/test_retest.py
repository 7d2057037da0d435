"""Reliability of an eye's answers, and tests that are repeated."""

import math
from dataclasses import asdict

import numpy as np
import pytest
from scipy.stats import beta

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.intervals import InterceptRule
from radiometer.adaptation.outcome import Count, Reliability
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.adaptation.visits import Compared, compare_visits, limits_of_agreement


def test_limits_are_mean_and_196_standard_deviations():
    """Differences −1, 0, 1, 2: mean 0.5, standard deviation 1.291; the mean's interval is Student's (t = 3.182)."""
    found = limits_of_agreement(np.array([-1.0, 0.0, 1.0, 2.0]))
    assert (found.mean.value, found.sd) == pytest.approx((0.5, math.sqrt(5 / 3)))
    assert (found.lower.value, found.upper.value) == pytest.approx((0.5 - 2.5303, 0.5 + 2.5303), abs=1e-4)
    assert (found.mean.low, found.mean.high) == pytest.approx((0.5 - 2.0543, 0.5 + 2.0543), abs=1e-3)
    with pytest.raises(ValueError, match="two"):
        limits_of_agreement(np.array([1.0]))


@pytest.mark.slow
def test_intervals_of_the_limits_are_one_sided_tolerance_factors():
    """Of 4000 sets of ten differences the upper limit's interval holds μ + 1.96 σ in 95 % (to 1.4 %)."""
    rng, held = np.random.default_rng(1), 0
    for row in rng.normal(0.3, 2.0, (4000, 10)):
        bound = limits_of_agreement(row).upper
        held += bound.low <= 0.3 + 1.959964 * 2.0 <= bound.high
    assert held / 4000 == pytest.approx(0.95, abs=0.014)
    unit = np.array([-1.0, 1.0] * 5) * math.sqrt(0.9)  # mean 0, standard deviation 1
    found = limits_of_agreement(unit)
    assert found.upper.high == pytest.approx(-found.lower.low)
    assert found.upper.high > found.upper.value > found.upper.low > 0


def _series(break_min, slope, seed):
    times = np.arange(0.3, 20, 0.3)
    cones = -1.5 + 2.5 * np.exp(-times / 1.5)
    rods = -1.5 + slope * (times - break_min)
    noise = np.random.default_rng(seed).normal(0, 0.05, times.size)
    return ThresholdSeries(times, np.where(times > break_min, rods, cones) + noise)


@pytest.mark.slow
def test_shift_between_visits_is_found_in_its_quantity_alone():
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
    found = {one.name: one for one in compare_visits(fits)}
    assert set(found) == {"break_min", "s2_slope_per_min", "rod_intercept_min", "plateau"}
    breaks = found["break_min"]
    assert breaks.agreement.mean.value == pytest.approx(1.0, abs=4 * breaks.u_fits / math.sqrt(3))
    assert abs(np.diff(found["s2_slope_per_min"].visits, axis=1).mean()) < 0.01
    assert found["rod_intercept_min"].visits[0, 1] - found["rod_intercept_min"].visits[0, 0] == pytest.approx(
        1.0, abs=0.2
    )
    assert compare_visits(fits[:2])[0].agreement is None


@pytest.mark.slow
def test_pair_without_a_break_is_left_out_and_named():
    """The second pair's second visit has one branch: its number is reported, its plateau is not compared."""
    times = np.arange(0.3, 20, 0.3)
    flat = ThresholdSeries(times, -1 + 2 * np.exp(-times / 3) + np.random.default_rng(3).normal(0, 0.05, times.size))
    request, rng = FitRequest(bootstrap_draws=0), np.random.default_rng(0)
    broken = [fit_adaptation(_series(9.0, -0.25, seed), request, rng) for seed in (11, 12, 13)]
    found = compare_visits([(broken[0], broken[1]), (broken[2], fit_adaptation(flat, request, rng))])
    assert [one.name for one in found] == ["break_min", "s2_slope_per_min", "plateau"]
    assert {(one.missing, len(one.visits)) for one in found} == {((2,), 1)}


@pytest.mark.parametrize("pairs", [2, 3])
def test_json_says_the_limits_where_there_are_enough_pairs(pairs):
    """Of three pairs and more; what is not known, or not a number, is null."""
    agreement = limits_of_agreement(np.array([-1.0, 0.0, 1.0])) if pairs > 2 else None
    shown = Compared(
        "plateau", "log10", np.ones((pairs, 2)), np.full((pairs, 2), math.nan), (4,), agreement
    ).to_mapping()
    assert (shown["pairs"], shown["pairs_without_it"], shown["u_difference_of_the_fits"]) == (pairs, [4], None)
    assert shown["agreement"] == (agreement and asdict(agreement))


FASTEST_S = 0.12


def _blink(level, *presses_s, **named):
    return {"kind": "blink", "log10_level": level, "presses_s": list(presses_s), **named}


def test_blinks_are_counted_by_what_they_were():
    """Blank ones by none, bright ones by their missing press; what is written before the thresholds is read again."""
    events = [
        _blink(-1.0, 0.4),
        _blink(None),
        _blink(None, 0.3),
        _blink(None, 0.05),
        _blink(0.0, 0.4, of="bright"),
        _blink(0.0, of="bright"),
        _blink(None, 0.5, of="blind_spot"),
        _blink(None, of="blind_spot"),
        _blink(None, of="blind_spot"),
        {"kind": "trial", "catch": True, "of": "blind_spot", "seen": False},
    ]
    assert Reliability.of_trials(events, FASTEST_S) == Reliability(Count(1, 3), Count(1, 2), Count(1, 3))
    counts = Reliability(Count(2, 90), Count(0, 20), Count(3, 30))
    assert counts.facts() == {"false_alarms": "2/90", "lapses": "0/20", "seen_at_blind_spot": "3/30"}
    assert Reliability.of_facts(counts.facts()) == counts
    assert Reliability.of_facts({"false_alarms": "many"}) == Reliability()


def test_interval_of_a_share_is_jeffreys():
    """5 of 50 by Beta(5.5, 45.5), the untried has none; looks away are (0.2 - 0.1)/(0.9·0.9) = 12.3 %."""
    rates = Reliability(Count(5, 50), Count(0, 20)).rates
    assert (set(rates), Reliability().rates) == ({"false_alarms", "lapses"}, {})
    low, high = beta.ppf([0.025, 0.975], 5.5, 45.5)
    assert (rates["false_alarms"].low, rates["false_alarms"].high) == pytest.approx((low, high), abs=0.002)
    assert rates["lapses"].low == 0.0
    assert rates["lapses"].high == pytest.approx(beta.ppf(0.975, 0.5, 20.5), abs=0.003)
    rate = Reliability(Count(10, 100), Count(10, 100), Count(20, 100)).rates["fixation_losses"]
    assert rate.value == pytest.approx(0.1 / 0.81)
    assert rate.low < 0.05 < rate.value < 0.2 < rate.high


@pytest.mark.long
@pytest.mark.parametrize("planted", [0.0, 0.05, 0.2, 0.4])
def test_intervals_hold_the_planted_share(planted):
    """With 30 lights, 100 blank and 25 bright blinks 93 % or more of 300 subjects (the same by chance to 1.3 %)."""
    rng = np.random.default_rng(round(1000 * planted))
    alarms, lapses, held = 0.02, 0.03, 0
    seen = alarms + (1 - alarms) * (1 - lapses) * planted
    for _ in range(300):
        counts = [Count(int(rng.binomial(n, p)), n) for n, p in ((100, alarms), (25, lapses), (30, seen))]
        rate = Reliability(*counts).rates["fixation_losses"]
        held += rate.low <= planted <= rate.high
    assert held >= 0.93 * 300
