"""Plans: which levels, in which order, with references."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.errors import UsageError
from radiometer.screen.plan import ScreenStep, make_plan, parse_levels


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("all", tuple(range(256))),
        ("quick", (0, 32, 64, 96, 128, 192, 255)),
        ("3", (0, 128, 255)),
        ("17,5", (0, 5, 17, 255)),
    ],
)
def test_levels_are_read(text: str, expected: tuple[int, ...]) -> None:
    """Every form of --levels gives ascending levels with black and white."""
    assert parse_levels(text) == expected


@pytest.mark.parametrize("text", ["2", "some", "-1,5", "5,300", "300"])
def test_senseless_levels_are_refused(text: str) -> None:
    """The message repeats the word and says what is allowed."""
    with pytest.raises(UsageError, match="--levels"):
        parse_levels(text)


def test_plan_holds_every_level_once_between_references() -> None:
    """Each level of each channel stands once; white and black begin, end and recur every ten."""
    plan = make_plan(tuple(range(0, 256, 15)), ("grey", "red"), np.random.default_rng(1))
    levels = [s for s in plan if s.purpose == "level"]
    assert len(set(levels)) == len(levels) == 36
    whites = [i for i, s in enumerate(plan) if s.purpose == "white"]
    assert whites[0] == 0
    assert whites[-1] == len(plan) - 2
    assert max(np.diff(whites)) <= 10 + 2


def test_order_is_random_but_follows_from_the_seed() -> None:
    """Two seeds differ, the same seed repeats, and levels do not simply rise."""
    one, again, other = (make_plan(parse_levels("33"), ("grey",), np.random.default_rng(s)) for s in (1, 1, 2))
    assert one == again != other
    levels = [s.level for s in one if s.purpose == "level"]
    assert levels != sorted(levels)


def test_unknown_channel_is_refused() -> None:
    """A typing error is named."""
    with pytest.raises(UsageError, match="channel 'gray' is unknown"):
        make_plan((0, 1, 2), ("gray",), np.random.default_rng(1))


def test_step_shows_its_primary_alone() -> None:
    """Level 51 of blue is a fifth of blue's drive and nothing else."""
    assert ScreenStep("blue", 51).patch().rgb == (0.0, 0.0, 0.2)
