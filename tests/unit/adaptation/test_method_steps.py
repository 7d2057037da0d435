"""Blink by blink: the levels that ascending limits and the staircase ask for, and the threshold that they come to."""

from __future__ import annotations

import pytest

from radiometer.adaptation.methods import Ascent, Staircase
from radiometer.adaptation.protocol import LimitsMethod, Spot, StaircaseMethod

SPOT = Spot(device="light_box", channel="spot", peak_nm=453, lowest_log10=-3.0, highest_log10=1.0)


def levels_of(method: Ascent | Staircase, answers: str) -> list[float]:
    """Return the levels asked for, by answers: y for seen, n for not."""
    asked = []
    for answer in answers:
        asked.append(round(method.level, 9))
        method.answer(seen=answer == "y")
    return asked


def test_a_staircase_takes_large_steps_until_its_first_turn() -> None:
    """0.4 up while nothing is seen, 0.2 either way from the first turn on; the mean of all turns but the first."""
    rules = StaircaseMethod(kind="staircase", first_step_log10=0.4, step_log10=0.2, start_below_log10=0.0, reversals=3)
    staircase = Staircase(SPOT, rules, last=-1.0)
    assert levels_of(staircase, "nnyn") == [-1.0, -0.6, -0.2, -0.4]
    turns = [-0.2, -0.4]
    assert levels_of(staircase, "yyn") == [-0.2, -0.4, -0.6]
    turns += [-0.2, -0.6]
    assert staircase.threshold == pytest.approx(sum(turns[1:]) / 3)


def test_a_staircase_gives_up_at_the_end_of_the_levels() -> None:
    """At the highest level not seen, or at the lowest seen, there is no step left."""
    rules = StaircaseMethod(kind="staircase", first_step_log10=0.4, step_log10=0.2, start_below_log10=0.0, reversals=3)
    for last, answers in ((0.9, "nn"), (-2.9, "yy")):
        staircase = Staircase(SPOT, rules, last=last)
        assert levels_of(staircase, answers)[1] == (1.0 if "n" in answers else -3.0)
        assert staircase.exhausted
        assert staircase.threshold is None


def test_an_ascent_climbs_until_it_is_seen_and_begins_lower_where_it_is_seen_at_once() -> None:
    """0.3 below the last threshold and half a step more; seen at once it begins 0.3 lower still."""
    rules = LimitsMethod(step_log10=0.1, start_below_log10=0.3)
    ascent = Ascent(SPOT, rules, last=-1.0, shift=0.5)
    assert levels_of(ascent, "ynny") == [-1.35, -1.65, -1.55, -1.45]
    assert ascent.threshold == pytest.approx(-1.45)
    floor = Ascent(SPOT, rules, last=-2.95)
    assert levels_of(floor, "y") == [-3.0]
    assert floor.exhausted
    ceiling = Ascent(SPOT, rules, last=1.2)
    assert levels_of(ceiling, "nn") == [0.9, 1.0]
    assert ceiling.exhausted


def test_a_spot_whose_levels_are_reversed_is_refused() -> None:
    """Nothing lies between them, nor where both are the same."""
    for highest in (-3.0, -3.1):
        with pytest.raises(ValueError, match="must be above"):
            Spot(device="light_box", channel="spot", peak_nm=453, lowest_log10=-3.0, highest_log10=highest)
