"""Cycles that may be there besides a drift: a planted one is the likeliest of those that are tried."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.archive.cycles import near_the_season, slow_cycles

YEAR_S = 365.25 * 86400.0


def record(years: float, readings: int, period_s: float) -> tuple[np.ndarray, ...]:
    """Return a level and a line, values with a cycle of 1 % and noise of 0.2 %, their sigma and their times."""
    time_s = np.linspace(0.0, years * YEAR_S, readings)
    noise = 0.002 * np.random.default_rng(7).standard_normal(readings)
    relative = 0.01 * np.sin(2 * np.pi * time_s / period_s + 0.4) + noise
    return np.column_stack([np.ones(readings), time_s / time_s[-1] - 0.5]), relative, np.full(readings, 0.002), time_s


def likeliest(found: list[tuple[float, float]]) -> float:
    return max(found, key=lambda one: one[1])[0]


@pytest.mark.parametrize("more", [-0.5, -0.375, -0.25, -0.125, 0.125, 0.25, 0.375, 0.5])
def test_a_cycle_nearly_as_long_as_the_season_is_the_likeliest_in_its_place(more: float) -> None:
    """Three years hold three seasons: of a cycle that comes 3 ± 1/8 to 3 ± 1/2 times the period is named."""
    planted_s = 3.0 * YEAR_S / (3.0 + more)
    found = near_the_season(*record(3.0, 160, planted_s), YEAR_S)
    assert likeliest(found) == pytest.approx(planted_s)
    assert all(2.4 < 3.0 * YEAR_S / period_s < 3.6 for period_s, _ in found)


def test_a_slow_cycle_is_named_from_enough_readings_on() -> None:
    """One that comes 1.5 times in the record is the likeliest of the slow ones; of eleven readings none is reported."""
    planted_s = 2.0 * YEAR_S / 1.5
    assert likeliest(slow_cycles(*record(2.0, 100, planted_s), ())) == pytest.approx(planted_s)
    assert slow_cycles(*record(2.0, 12, planted_s), ()) != []
    assert slow_cycles(*record(2.0, 11, planted_s), ()) == []
    assert slow_cycles(*record(2.0, 100, planted_s), [2.0 * YEAR_S / n for n in (1.0, 2.0, 3.0, 4.0)]) == []
