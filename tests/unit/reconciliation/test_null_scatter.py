"""Of a camera that is as declared, every statistic of reconcile scatters by what is stated of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from radiometer.reconciliation.fit.descent import converged_fit, first_state
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import frame_reader, reduce_frames
from radiometer.reconciliation.statistics import STATISTICS

# The knife-edge's u holds an allowance for how sharp a border is, and an even chart of a sound sensor has no outliers.
STATED_LARGER = {"edge", "outliers"}


@pytest.fixture(scope="module")
def chi2(make_capture: Callable[..., Any]) -> dict[str, tuple[float, int]]:
    """Return χ² and number of entries of each statistic, summed over three sessions without any effect."""
    total = dict.fromkeys(STATISTICS, (0.0, 0))
    for seed in (101, 102, 103):
        captured = make_capture(seed, 4)
        design = Design.of(captured.header, captured.frames[0].shape)
        state = converged_fit(first_state(design, *reduce_frames(design, frame_reader(captured.frames))))
        for name, cut in state.comparison.cuts.items():
            squares, count = total[name]
            rest = state.comparison.residual(state.prediction)[cut]
            total[name] = squares + float(rest @ rest), count + state.comparison.degrees(name)
    return total


@pytest.mark.parametrize("name", STATISTICS)
def test_a_statistic_scatters_by_its_stated_uncertainty(chi2: dict[str, tuple[float, int]], name: str) -> None:
    """χ²/n is 1 within five of its own sigma, √(2/n), and the 5 % that the fitted levels of 24 patches take up."""
    squares, count = chi2[name]
    assert count > 0
    allowed = 5.0 * math.sqrt(2.0 / count)
    assert squares / count < 1.0 + allowed
    if name not in STATED_LARGER:
        assert squares / count > 1.0 - allowed - 0.05
