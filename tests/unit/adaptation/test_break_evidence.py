"""A break is claimed only where the fall quickens."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.break_evidence import (
    LEAST_DEVIANCE,
    convex_sum_of_squares,
    earliest_visible_break,
)
from radiometer.adaptation.threshold_series import ThresholdSeries

TIMES = np.arange(0.25, 25.0, 0.25)
QUICK = FitRequest(bootstrap_draws=0)


def rods_alone(times: np.ndarray) -> np.ndarray:
    """Return rods after a weak bleach: S2 −0.24 for 6 min, S3 −0.04 for 8 min, then their final level."""
    return -0.24 * np.minimum(times, 6.0) - 0.04 * np.clip(times - 6.0, 0.0, 8.0)


def test_falling_convex_curves_are_met_and_a_quickening_fall_is_not():
    """A hinge at a knot leaves nothing; of −t² on 0..1 the chord by least squares is best: mean square 1/180."""
    weights = np.ones(TIMES.size)
    assert convex_sum_of_squares(TIMES, np.maximum(10.0 - TIMES, 0.0), weights) < 0.02
    fine = np.linspace(0.0, 1.0, 400)
    assert convex_sum_of_squares(fine, -(fine**2), np.ones(400)) / 400 == pytest.approx(1 / 180, rel=0.02)


def test_weights_count():
    """A threshold of no weight bends no curve."""
    level, weights = np.zeros(40), np.ones(40)
    level[20], weights[20] = 5.0, 0.0
    assert convex_sum_of_squares(np.arange(40.0), level, weights) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_rods_alone_have_no_break(seed):
    """S2 that gives way to S3 is no rod–cone break; the verdict says what could have been seen."""
    noise = np.random.default_rng(seed).normal(0, 0.08, TIMES.size)
    found = fit_adaptation(ThresholdSeries(TIMES, rods_alone(TIMES) + noise), QUICK, np.random.default_rng(0))
    assert not found.has_break
    assert found.evidence.deviance < LEAST_DEVIANCE
    assert found.evidence.earliest_visible_min is not None
    assert f"a break earlier than {found.evidence.earliest_visible_min:.1f} min cannot be seen" in found.verdict


@pytest.mark.slow
def test_early_break_is_found_where_it_can_be_seen():
    """Cones for 5 min at −1, then rods at −0.24 per min: found, with evidence well beyond what is needed."""
    curve = -1 + 2 * np.exp(-np.minimum(TIMES, 5.0) / 1.2) - 0.24 * np.clip(TIMES - 5.0, 0.0, 9.0)
    noise = np.random.default_rng(2).normal(0, 0.08, TIMES.size)
    found = fit_adaptation(ThresholdSeries(TIMES, curve + noise), QUICK, np.random.default_rng(0))
    assert found.estimates["break_min"].value == pytest.approx(5.0, abs=0.6)
    assert found.evidence.deviance > 2 * LEAST_DEVIANCE
    assert earliest_visible_break(TIMES, 0.08, 4.0) < 7.0


def test_power_falls_with_scatter_and_with_fewer_thresholds():
    """The earliest break that can be seen comes later with more scatter; with far too much none can."""
    times = [earliest_visible_break(TIMES, sigma, 3.0) for sigma in (0.02, 0.08, 0.2)]
    assert times == sorted(times)
    assert times[0] < times[2]
    assert earliest_visible_break(TIMES[::4], 0.1, 3.0) > earliest_visible_break(TIMES, 0.1, 3.0)
    assert earliest_visible_break(TIMES, 3.0, 3.0) is None
