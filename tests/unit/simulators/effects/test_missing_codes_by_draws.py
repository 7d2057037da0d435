"""What missing codes cut off, against draws: noise far narrower than their step, which the series does not resolve."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from simulators.effects import missing_codes
from simulators.effects.missing_codes import MissingCodes

DRAWS = 400_000


@pytest.mark.parametrize(("u", "step", "sd"), [(10.02, 2, 0.05), (11.0, 2, 0.02), (9.99, 2, 0.04), (24.03, 8, 0.06)])
def test_mean_square_and_slope_of_what_a_grid_cuts_off(u: float, step: int, sd: float) -> None:
    """A normal variable less the next code of the grid below it; the slope is that of its mean."""
    drawn = np.random.default_rng(7).normal(u, sd, DRAWS)
    cut = drawn - step * np.floor(drawn / step)
    mean, square, slope = missing_codes._expected(np.array([u]), np.array([sd**2]), step, 1)
    assert mean[0] == pytest.approx(cut.mean(), abs=5.0 * cut.std() / DRAWS**0.5 + 1e-6)
    assert square[0] == pytest.approx(np.mean(cut**2), abs=5.0 * np.std(cut**2) / DRAWS**0.5 + 1e-6)
    near = 1e-3 * sd
    beside = [missing_codes._expected(np.array([at]), np.array([sd**2]), step, 1)[0][0] for at in (u - near, u + near)]
    assert slope[0] == pytest.approx((beside[1] - beside[0]) / (2.0 * near), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    ("period", "kept"), [(2, 1), (4, 1), (8, 1), (16, 1), (3, 2), (4, 2), (4, 3), (8, 7), (16, 15)]
)
def test_a_search_tries_the_codes_that_converters_leave_out(period: int, kept: int) -> None:
    """Bits that are stuck, one code of a period that never comes: some trial leaves exactly those codes."""
    codes, anywhere = np.arange(64.0), cast(Any, None)
    wanted = set(codes[codes % period < kept])
    found = [set(np.ravel(MissingCodes(**trial).mean(codes, anywhere))) for trial in MissingCodes.trials]
    assert wanted in found
