"""A free law for one name: where its knots lie, and when it stands in place of what was found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.fit.candidate_fit import Candidate, fit_candidate
from radiometer.reconciliation.fit.descent import converged_fit, refit, scatter_of
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.result import FittedParameter, LawCurve
from radiometer.reconciliation.search.screening import best_start
from radiometer.reconciliation.search.search import free_forms, loosened, worth
from radiometer.reconciliation.verdict import sizes_by_own_law
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.fnumber_tstop_error import FnumberTstopError
from simulators.effects.free_law import FreeLaw
from simulators.effects.gain_step_error import GainStepError
from simulators.effects.gamma_enabled import GammaEnabled
from testing.reduced import start_of

TIMES = np.geomspace(1e-4, 6e-3, 9)
PLAN = [{"t": float(t)} for t in TIMES for _ in range(2)] + [{"t": t, "shutter": "closed"} for t in (1e-4, 1.0)]


@pytest.fixture(scope="module")
def late(make_capture: Callable[..., Any]) -> FitState:
    """Return the ideal camera fitted to exposures that are too long by 8 µs, and by five times that from 1 ms on."""
    captured = make_capture(seed=81, plan=PLAN, exposure=lambda t: t + (8e-6 if t < 1e-3 else 40e-6))
    return start_of(captured)


def test_knots_lie_where_the_effect_does_something(late: FitState) -> None:
    """Five and nine of them, from the shortest to the longest exposure with light; the dark second holds none."""
    forms = free_forms(late, ExposureTimeOffset(8e-6))
    assert [len(form.law) for form in forms] == [5, 9]
    for form in forms:
        knots = form.knots("exposure_s")
        assert (knots[0], knots[-1]) == pytest.approx((1e-4, 6e-3), rel=1e-4)
        assert set(form.law) == {1.0}


def test_no_law_is_free_where_nothing_varies(late: FitState) -> None:
    """One stop and one gain give no curve along them; a table along radius and stop needs both."""
    assert free_forms(late, FnumberTstopError(0.01)) == ()
    assert free_forms(late, GainStepError(0.01)) == ()
    assert {form.axes for form in free_forms(late, AngleDependence(0.1))} == {("field_radius",)}


@pytest.mark.slow
def test_a_name_takes_the_law_that_the_data_follow(late: FitState) -> None:
    """The exposure's error predicts best by a curve that is five times as high at the end, and leaves nothing then."""
    plain = converged_fit(refit(with_effects(late, [ExposureTimeOffset(8e-6)])))
    found = loosened(plain)
    assert found is not None
    assert worth(found) > worth(plain) + 20.0
    (form,) = found.effects
    assert isinstance(form, FreeLaw)
    context = late.model.context
    factor = np.ravel(form.weight(np.ones(1), context))[np.argsort(late.design.exposure_s)]
    assert factor[-4] / factor[0] == pytest.approx(5.0, rel=0.3)
    assert scatter_of(found) == 1.0


def test_starts_are_sized_about_where_they_do_nothing(late: FitState) -> None:
    """A gamma of 1.02 that must be ten times as strong starts at 1.2, not at 10."""
    captured = best_start(late, (GammaEnabled(1.02),))
    assert captured is not None
    assert all(abs(start.gamma - 1.0) < 0.5 for start in (captured.effect, *captured.others))


def test_a_curve_stands_in_json_with_its_band(late: FitState) -> None:
    """Knots by covariate, factors and their u; a plain effect has none."""
    form = free_forms(late, ExposureTimeOffset(8e-6))[0]
    fitted = {name: FittedParameter(1.5, 0.1, "1") for name in form.law_names()}
    curve = LawCurve.of(form, fitted)
    assert curve is not None
    mapping = curve.to_mapping()
    assert list(mapping["along"]) == ["exposure_s"]
    assert (mapping["factor"], mapping["u"]) == ([1.5] * 5, [0.1] * 5)
    assert LawCurve.of(ExposureTimeOffset(8e-6), {}) is None


def test_the_size_of_another_law_is_reported_with_its_u(late: FitState) -> None:
    """Exposures 8 to 24 µs too long: a law about 12 µs gives these, as uncertain as the own equation's size is off."""
    form = free_forms(late, ExposureTimeOffset(12e-6))[0]
    reported = sizes_by_own_law(with_effects(late, [form]), form)["offset_s"]
    plain = refit(with_effects(late, [ExposureTimeOffset(12e-6)])).effects[0]
    assert isinstance(plain, ExposureTimeOffset)
    assert reported.value == 12e-6
    assert reported.u is not None
    assert abs(plain.offset_s - 12e-6) <= reported.u < 16e-6


def test_each_variant_is_fitted(late: FitState) -> None:
    """A gamma above the black level and one of all codes are two."""
    starts = (GammaEnabled(1.02), GammaEnabled(1.02, above_black=1.0))
    both = fit_candidate(late, Candidate(starts[0], 0.0, 1, others=starts[1:]))
    assert {form.above_black for form in both.forms} == {0.0, 1.0}
