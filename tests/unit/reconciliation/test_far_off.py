"""What is asked of a candidate, near the data and where everything is far off."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from radiometer.reconciliation.fit.covariance import is_far
from radiometer.reconciliation.search.score import is_shown
from radiometer.reconciliation.thresholds import FAR_GAP, HUGE_NATS


def _candidate(gain: float, evidence: float) -> Any:
    effect = SimpleNamespace(log_prior_odds=0.0)
    return SimpleNamespace(
        gain=gain, evidence=evidence, effect=effect, tries=1, stated=0.0, flexible=False, parameters=1
    )


@pytest.mark.parametrize(("gap", "far"), [(1.0, False), (0.99 * FAR_GAP, False), (FAR_GAP, True), (1e4, True)])
def test_a_model_is_far_off_by_ten_uncertainties(gap: float, far: bool) -> None:
    """A reduced χ² of a hundred is ten uncertainties of every entry."""
    state: Any = SimpleNamespace(gap=gap)
    assert is_far(state) is far


def test_the_statistic_that_must_show_an_effect_is_asked_near_the_data() -> None:
    """Near, what explains only others' statistics is none; far off the full fit is asked, if very much is explained."""
    own, others = _candidate(3e5, 9.0), _candidate(3e5, -6e4)
    assert is_shown(own, 1.3e5, -5.0, later=False)
    assert not is_shown(others, 1.3e5, -5.0, later=False)
    assert is_shown(others, 1.3e5, -5.0, later=False, far=True)
    assert not is_shown(others, 0.9 * HUGE_NATS, -5.0, later=False, far=True)
    assert is_shown(own, 0.9 * HUGE_NATS, -5.0, later=False, far=True)
    assert not is_shown(_candidate(3e5, 7.9), 1.3e5, -5.0, later=False)
