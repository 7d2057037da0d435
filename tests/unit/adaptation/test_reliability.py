"""False alarms, lapses and looks away: what is counted, and the shares that follow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import beta

from radiometer.adaptation.reliability import Count, Reliability

FASTEST_S = 0.12


def _blink(level: float | None, *presses_s: float, **named: str) -> dict[str, Any]:
    return {"kind": "blink", "log10_level": level, "presses_s": list(presses_s), **named}


def test_blinks_are_counted_by_what_they_were() -> None:
    """Blank ones by none, bright ones by their missing press; a search's blinks and hasty presses count for nothing."""
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


def test_looks_away_are_what_false_alarms_and_lapses_leave() -> None:
    """20 % of the lights seen, 10 % false alarms, 10 % lapses: (0.2 - 0.1)/(0.9·0.9) = 12.3 %."""
    rate = Reliability(Count(10, 100), Count(10, 100), Count(20, 100)).rates["fixation_losses"]
    assert rate.value == pytest.approx(0.1 / 0.81)
    assert rate.low < 0.05 < rate.value < 0.2 < rate.high


def test_interval_of_a_share_is_jeffreys() -> None:
    """5 of 50: quantiles of Beta(5.5, 45.5), to what 40 000 draws give; never seen reaches to 0."""
    rates = Reliability(Count(5, 50), Count(0, 20)).rates
    low, high = beta.ppf([0.025, 0.975], 5.5, 45.5)
    assert (rates["false_alarms"].low, rates["false_alarms"].high) == pytest.approx((low, high), abs=0.002)
    assert rates["lapses"].low == 0.0
    assert rates["lapses"].high == pytest.approx(beta.ppf(0.975, 0.5, 20.5), abs=0.003)


def test_what_was_not_tried_has_no_share() -> None:
    """Without a light in the blind spot nothing is stated of fixation."""
    assert set(Reliability(Count(1, 30)).rates) == {"false_alarms"}
    assert Reliability().rates == {}


@pytest.mark.slow
@pytest.mark.parametrize("planted", [0.05, *(pytest.param(one, marks=pytest.mark.long) for one in (0.0, 0.2, 0.4))])
def test_intervals_hold_the_planted_share(planted: float) -> None:
    """With 30 lights, 100 blank and 25 bright blinks 93 % or more of 300 subjects (the same by chance to 1.3 %)."""
    rng = np.random.default_rng(round(1000 * planted))
    alarms, lapses, held = 0.02, 0.03, 0
    seen = alarms + (1 - alarms) * (1 - lapses) * planted
    for _ in range(300):
        counts = [Count(int(rng.binomial(n, p)), n) for n, p in ((100, alarms), (25, lapses), (30, seen))]
        rate = Reliability(*counts).rates["fixation_losses"]
        held += rate.low <= planted <= rate.high
    assert held >= 0.93 * 300


def test_counts_travel_with_the_thresholds() -> None:
    """What is written before the thresholds is read again; nonsense is nothing."""
    counts = Reliability(Count(2, 90), Count(0, 20), Count(3, 30))
    assert counts.facts() == {"false_alarms": "2/90", "lapses": "0/20", "seen_at_blind_spot": "3/30"}
    assert Reliability.of_facts(counts.facts()) == counts
    assert Reliability.of_facts({"false_alarms": "many"}) == Reliability()
