"""Interpolation of levels: through the points, never falling, and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.screen.interpolation import LevelTable, rising


def test_table_goes_through_its_points() -> None:
    """Values at measured levels are the measured ones."""
    levels, values = np.array([0.0, 0.3, 0.6, 1.0]), np.array([0.1, 10.0, 60.0, 250.0])
    assert LevelTable(levels, values).at(levels) == pytest.approx(values, rel=1e-12)


def test_power_law_is_met_between_points() -> None:
    """A power law of 2.2 is a straight line to the table, so nothing is missed between 9 of its points."""
    levels = np.linspace(0, 1, 9)
    fine = np.linspace(0, 1, 101)
    assert LevelTable(levels, levels**2.2).at(fine) == pytest.approx(fine**2.2, rel=1e-9, abs=1e-12)


@given(st.lists(st.floats(0, 1000), min_size=3, max_size=20))
def test_values_never_fall_and_the_inverse_leads_back(numbers: list[float]) -> None:
    """Whatever is measured, more drive never gives less, and level_of reaches its target."""
    values = rising(numbers, np.ones(len(numbers)))
    table = LevelTable(np.linspace(0, 1, len(numbers)), values)
    fine = table.at(np.linspace(0, 1, 200))
    assert np.all(np.diff(fine) >= -1e-9 * max(values.max(), 1e-300))
    target = float(values[0] + 0.37 * (values[-1] - values[0]))
    assert float(table.at(table.level_of(target))) >= target * (1 - 1e-9)


def test_rising_weighs_by_uncertainty() -> None:
    """Of two values in the wrong order the better known one stays nearly where it is."""
    fitted = rising([1.0, 3.0, 2.0, 4.0], [0.1, 1.0, 0.01, 0.1])
    assert fitted[1] == fitted[2] == pytest.approx(2.0, abs=1e-3)
