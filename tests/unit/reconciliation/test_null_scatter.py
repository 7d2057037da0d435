"""Of a camera that is as its model says, every statistic of reconcile scatters by what is stated of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.descent import converged_fit
from radiometer.reconciliation.fit.state import with_effects
from radiometer.reconciliation.statistics import STATISTICS
from simulators.effects.registry import make_effect
from testing.reduced import start_of

# The knife-edge's u holds an allowance for how sharp a border is, and an even chart of a sound sensor has no outliers.
STATED_LARGER = {"edge", "outliers"}
ROWS, COLUMNS, E_PER_DN = 64, 96, 2.6  # of the synthetic camera of conftest.py
Chi2 = dict[str, tuple[float, int]]


def chi2_of(captured: Any, *effects: Any) -> Chi2:
    """Return χ² and number of entries of each statistic, where these effects are part of the model."""
    state = start_of(captured)
    state = converged_fit(with_effects(state, list(effects)) if effects else state)
    rest = state.data_residual
    return {
        name: (float(rest[cut] @ rest[cut]), state.comparison.degrees(name))
        for name, cut in state.comparison.cuts.items()
    }


@pytest.fixture(scope="module")
def sound(make_capture: Callable[..., Any]) -> Chi2:
    """Return χ² and entries summed over two sessions without any effect."""
    found = [chi2_of(make_capture(seed, 4)) for seed in (101, 102)]
    return {name: (sum(one[name][0] for one in found), sum(one[name][1] for one in found)) for name in STATISTICS}


@pytest.mark.parametrize("name", STATISTICS)
def test_a_statistic_scatters_by_its_stated_uncertainty(sound: Chi2, name: str) -> None:
    """χ²/n is 1 within five of its own sigma, √(2/n), and the 5 % that the fitted levels of 24 patches take up."""
    squares, count = sound[name]
    assert count > 0
    allowed = 5.0 * math.sqrt(2.0 / count)
    assert squares / count < 1.0 + allowed
    if name not in STATED_LARGER:
        assert squares / count > 1.0 - allowed - 0.05


def gain(setting: Any) -> float:
    """Return DN per electron at a setting's gain."""
    return float(10.0 ** (setting["g"] / 20.0) / E_PER_DN)


RNG = np.random.default_rng(20261126)
FIXED = {shape: RNG.standard_normal(shape) for shape in ((ROWS, 1), (1, COLUMNS), (ROWS, COLUMNS))}
HIDDEN: dict[str, tuple[dict[str, float], dict[str, Any]]] = {
    "row_temporal_noise": (
        {"sigma_e": 4.0}, {"extra_dn": lambda s: 4.0 * gain(s) * RNG.standard_normal((ROWS, 1))}
    ),
    "excess_read_noise": (
        {"excess_e": 5.0}, {"extra_dn": lambda s: 5.0 * gain(s) * RNG.standard_normal((ROWS, COLUMNS))}
    ),
    "exposure_time_offset": ({"offset_s": 8e-6}, {"exposure": lambda t: t + 8e-6}),
    "row_pattern": ({"sigma_e": 4.0}, {"extra_dn": lambda s: 4.0 * gain(s) * FIXED[ROWS, 1]}),
    "column_pattern": ({"sigma_e": 4.0}, {"extra_dn": lambda s: 4.0 * gain(s) * FIXED[1, COLUMNS]}),
    "prnu": ({"sigma_rel": 0.01}, {"picture": lambda image, s: image * (1.0 + 0.01 * FIXED[ROWS, COLUMNS])}),
}  # fmt: skip


ALIKE = {"row_pattern", "excess_read_noise"}  # act as the column pattern and the rows' noise do


@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.slow) if one in ALIKE else one for one in HIDDEN])
def test_statistics_scatter_as_stated_where_the_model_holds_the_effect(
    make_capture: Callable[..., Any], name: str
) -> None:
    """With the camera's true effect in the model nothing is left: χ²/n of all statistics is 1 within 6 sigma.

    Chance shifts of the tiles that a fixed pattern makes alike in all captures are fitted; profiles of its lines
    are nearly used up by them.
    """
    values, hooks = HIDDEN[name]
    found = chi2_of(make_capture(201, 4, **hooks), make_effect(name, values))
    own = {"row_pattern": "rows", "column_pattern": "columns"}.get(name)
    for block in STATISTICS:
        squares, count = found[block]
        allowed = 6.0 * math.sqrt(2.0 / max(count, 1)) + 0.1
        assert squares / max(count, 1) < 1.0 + allowed, block
        if count and block not in {*STATED_LARGER, own}:
            assert squares / count > 1.0 - allowed, block
