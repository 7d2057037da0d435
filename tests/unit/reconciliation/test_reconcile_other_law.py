"""A right name by another equation than the catalogue's: stated of the name, not left next to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.descent import refit
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.search.search import Search, Step
from radiometer.reconciliation.verdict import Verdict, rest_of, verdict_of, with_other_functional_form
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from testing.reduced import start_of

PLAN = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 6) for _ in range(2)] + [{"t": 1e-2, "shutter": "closed"}]


@pytest.fixture(scope="module")
def late(make_capture: Callable[..., Any]) -> FitState:
    """Return a model with exposures that are 8 µs longer than stated, as they were taken."""
    captured = make_capture(seed=71, plan=PLAN, exposure=lambda t: t + 8e-6)
    start = start_of(captured)
    return refit(with_effects(start, [ExposureTimeOffset(8e-6)]))


def _outcome(state: FitState, *unnamed: Step, nats: float = 300.0) -> Search:
    named = Step("exposure_time_offset", "exposure_s", nats, 1.4, 1.1)
    return Search(state, state, (named, *unnamed), (), ())


def _left(where: str, block: str, nats: float) -> Step:
    return Step("unnamed", where, nats, 1.1, 1.0, block=block)


def test_what_stays_in_a_names_own_place_is_its_law(late: FitState) -> None:
    """A curve along the exposure next to an exposure's error is no second cause; the verdict stays provisional."""
    outcome = _outcome(late, _left("exposure_s", "mean", 30.0))
    assert [effect.name for effect in with_other_functional_form(outcome)] == ["exposure_time_offset"]
    assert rest_of(outcome) is None
    assert verdict_of(outcome, []) is Verdict.INCOMPLETE


def test_what_stays_elsewhere_or_is_most_of_it_is_left_without_a_name(late: FitState) -> None:
    """Along the picture, in the noise, or where the name brings less than four fifths, it stands as the rest."""
    for step in (_left("image_x", "mean", 30.0), _left("exposure_s", "variance", 30.0)):
        outcome = _outcome(late, step)
        rest = rest_of(outcome)
        assert with_other_functional_form(outcome) == ()
        assert rest is not None
        assert (rest.where, rest.block) == (step.where, step.block)
    most = _outcome(late, _left("exposure_s", "mean", 100.0))
    rest = rest_of(most)
    assert with_other_functional_form(most) == ()
    assert rest is not None
    assert (rest.where, rest.gain_nats) == ("exposure_s", 100.0)
