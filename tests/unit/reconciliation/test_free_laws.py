"""A free law for one name: where its knots lie, and when it stands in place of what was found."""

import numpy as np
import pytest

from radiometer.reconciliation.descent import (
    Candidate,
    converged_fit,
    fit_candidate,
    fitted_parameters,
    included,
    refit,
    scatter_of,
)
from radiometer.reconciliation.localise import departing, localise, significant
from radiometer.reconciliation.result import FittedParameter, LawCurve
from radiometer.reconciliation.screening import best_start
from radiometer.reconciliation.search import Search, Step, free_forms, loosened, swapped, worth
from radiometer.reconciliation.state import with_effects
from radiometer.reconciliation.verdict import Verdict, rest_of, sizes_by_own_law, verdict_of, with_other_functional_form
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.dark_current_nonuniformity import DarkCurrentNonuniformity
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.fnumber_tstop_error import FnumberTstopError
from simulators.effects.gain_step_error import GainStepError
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.veiling_glare import VeilingGlare
from testing.reduced import start_of

TIMES = np.geomspace(1e-4, 6e-3, 9)
PLAN = [{"t": float(t)} for t in TIMES for _ in range(2)] + [{"t": t, "shutter": "closed"} for t in (1e-4, 1.0)]


@pytest.fixture(scope="module")
def late(make_capture):
    """Return the ideal camera fitted to exposures that are too long by 8 µs, and by five times that from 1 ms on."""
    captured = make_capture(seed=81, plan=PLAN, exposure=lambda t: t + (8e-6 if t < 1e-3 else 40e-6))
    return start_of(captured)


def test_knots_and_starts_lie_where_the_effect_does_something(late):
    """Not in darkness, not where nothing varies; a gamma starts at 1.2."""
    forms = free_forms(late, ExposureTimeOffset(8e-6))
    assert [len(form.law) for form in forms] == [5, 9]
    for form in forms:
        knots = form.knots("exposure_s")
        assert (knots[0], knots[-1]) == pytest.approx((1e-4, 6e-3), rel=1e-4)
        assert set(form.law) == {1.0}
    assert free_forms(late, FnumberTstopError(0.01)) == ()
    assert free_forms(late, GainStepError(0.01)) == ()
    assert {form.axes for form in free_forms(late, AngleDependence(0.1))} == {("field_radius",)}
    captured = best_start(late, (GammaEnabled(1.02),))
    assert all(abs(start.gamma - 1.0) < 0.5 for start in (captured.effect, *captured.others))


@pytest.mark.slow
def test_a_free_law_follows_what_the_data_do(late):
    """The exposure's error predicts best by a curve that is five times as high at the end."""
    found = max((included(late, form) for form in free_forms(late, ExposureTimeOffset(8e-6))), key=worth)
    assert worth(found) > worth(late) + 60.0
    (form,) = found.effects
    factor = np.ravel(form.weight(np.ones(1), late.model.context))[np.argsort(late.design.exposure_s)]
    assert factor[-4] / factor[0] == pytest.approx(5.0, rel=0.3)
    assert scatter_of(found) == 1.0


def test_a_curve_is_reported_with_its_band_and_size(late):
    """Knots, factors and u in JSON; 8 to 24 µs are as uncertain as the own equation's size is off."""
    form = free_forms(late, ExposureTimeOffset(8e-6))[0]
    fitted = {name: FittedParameter(1.5, 0.1, "1") for name in form.law_names()}
    curve = LawCurve.of(form, fitted)
    mapping = curve.to_mapping()
    assert list(mapping["along"]) == ["exposure_s"]
    assert (mapping["factor"], mapping["u"]) == ([1.5] * 5, [0.1] * 5)
    assert LawCurve.of(ExposureTimeOffset(8e-6), {}) is None
    form = free_forms(late, ExposureTimeOffset(12e-6))[0]
    reported = sizes_by_own_law(with_effects(late, [form]), form)["offset_s"]
    plain = refit(with_effects(late, [ExposureTimeOffset(12e-6)])).effects[0]
    assert reported.value == 12e-6
    assert abs(plain.offset_s - 12e-6) <= reported.u < 16e-6
    starts = (GammaEnabled(1.02), GammaEnabled(1.02, above_black=1.0))
    both = fit_candidate(late, Candidate(starts[0], 0.0, 1, others=starts[1:]))
    assert {form.above_black for form in both.forms} == {0.0, 1.0}


# A right name by another equation than the catalogue's is stated of the name, not left next to it.


SHORT_PLAN = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 6) for _ in range(2)] + [
    {"t": 1e-2, "shutter": "closed"}
]


@pytest.fixture(scope="module")
def late_alike(make_capture):
    """Return a model with exposures that are 8 µs longer than stated, as they were taken."""
    captured = make_capture(seed=71, plan=SHORT_PLAN, exposure=lambda t: t + 8e-6)
    start = start_of(captured)
    return refit(with_effects(start, [ExposureTimeOffset(8e-6)]))


def _outcome(state, *unnamed, nats=300.0):
    named = Step("exposure_time_offset", "exposure_s", nats, 1.4, 1.1)
    return Search(state, state, (named, *unnamed), (), ())


def _left(where, block, nats):
    return Step("unnamed", where, nats, 1.1, 1.0, block=block)


def test_what_stays_is_a_law_in_its_own_place_and_else_no_name(late_alike):
    """A curve along the exposure is no second cause; elsewhere it has no name."""
    outcome = _outcome(late_alike, _left("exposure_s", "mean", 30.0))
    assert [effect.name for effect in with_other_functional_form(outcome)] == ["exposure_time_offset"]
    assert rest_of(outcome) is None
    assert verdict_of(outcome, []) is Verdict.INCOMPLETE
    for step in (_left("image_x", "mean", 30.0), _left("exposure_s", "variance", 30.0)):
        outcome = _outcome(late_alike, step)
        rest = rest_of(outcome)
        assert with_other_functional_form(outcome) == ()
        assert (rest.where, rest.block) == (step.where, step.block)
    most = _outcome(late_alike, _left("exposure_s", "mean", 100.0))
    rest = rest_of(most)
    assert with_other_functional_form(most) == ()
    assert (rest.where, rest.gain_nats) == ("exposure_s", 100.0)


# When a named effect takes a more flexible form, or gives way to another.


def _with(effect, captured, *more):
    state = start_of(captured)
    return converged_fit(refit(with_effects(state, [effect, *more])))


def _weaker(loss, onset):
    """Return what hides a lamp that loses light beyond some drive only."""
    return lambda image, setting: image * (1.0 - loss * max(setting["d"] - onset, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(("onset", "corrected"), [(1.0 / 3.0, True), (0.0, False)])
def test_droop_beyond_some_drive_takes_one_term_more(make_capture, onset, corrected):
    """Light lost beyond a third of full drive leaves structure along the drive that a cubic law takes up; else none."""
    state = _with(LedThermalDroop(0.02, 0.01), make_capture(3, picture=_weaker(0.12, onset)))
    strange = departing(localise(state), state.effects)
    assert strange == (["led_thermal_droop"] if corrected else [])
    form = loosened(state, ["led_thermal_droop"])
    assert (form is not None) is corrected
    if form is not None:
        assert departing(localise(form), form.effects) == []


@pytest.mark.slow
def test_leaks_that_double_slowly_bring_their_own_doubling(make_capture):
    """A pattern of leaks that doubles every 10 K instead of 7 is found to do so within three of its uncertainties."""
    each = np.random.default_rng(5).gamma(4.0, 0.25, (64, 96)) - 1.0  # none leaks less than nothing
    darks = [{"t": t, "T": c, "shutter": "closed"} for t in (1.0, 3.0, 10.0) for c in (25.0, 35.0, 45.0)]
    plan = [*darks, *darks, *({"t": t} for t in (1e-3, 3e-3, 5e-3) for _ in range(2))]
    captured = make_capture(4, extra_e=lambda s: each * 2.0 ** ((s["T"] - 25.0) / 10.0) * s["t"], plan=plan)
    found = fitted_parameters(_with(DarkCurrentNonuniformity(0.6, doubling_K=7.2), captured))[
        "dark_current_nonuniformity"
    ]
    for name, truth in (("doubling_K", 10.0), ("sigma_e_per_s", 0.5)):
        u = found[name].u
        assert abs(found[name].value - truth) < 3.0 * u < 0.1 * truth


@pytest.mark.slow
def test_the_mean_of_uneven_leaks_is_the_dark_current_s(make_capture):
    """Log-normal leaks of 4 e-/s in the mean, doubling in 5 K: the rate takes the mean, the pattern none of it."""
    drawn = np.random.default_rng(6).lognormal(0.0, 0.5, (64, 96))
    leak = 4.0 * drawn / drawn.mean()
    darks = [{"t": t, "T": c, "shutter": "closed"} for t in (1.0, 3.0, 10.0) for c in (20.0, 25.0, 30.0)]
    plan = [*darks, *darks, *({"t": t} for t in (1e-3, 3e-3, 5e-3) for _ in range(2))]
    captured = make_capture(4, extra_e=lambda s: leak * 2.0 ** ((s["T"] - 25.0) / 5.0) * s["t"], plan=plan)
    parameters = fitted_parameters(_with(DarkCurrentNonuniformity(2.0, doubling_K=7.2), captured, DarkCurrent(3.0)))
    for name, key, truth in (
        ("dark_current", "rate_e_per_s", 4.0),
        ("dark_current", "doubling_K", 5.0),
        ("dark_current_nonuniformity", "sigma_e_per_s", float(leak.std())),
        ("dark_current_nonuniformity", "doubling_K", 5.0),
    ):
        found = parameters[name][key]
        assert abs(found.value - truth) < 4.0 * found.u < 0.15 * truth


@pytest.mark.slow
@pytest.mark.parametrize("uneven", [True, False])
def test_leaks_that_are_more_at_the_bottom_rise_over_the_sensor(make_capture, uneven):
    """Leaks that grow e-fold within a third of the rows: the pattern rises and bends as they do; else it is even."""
    drawn = np.random.default_rng(7).lognormal(0.0, 0.5, (64, 96))
    down = np.linspace(-1.0, 1.0, 64)[:, None]
    more = 0.8 * np.exp((down - 1.0) / 0.67) * uneven
    leak = 4.0 * drawn / drawn.mean() + more
    darks = [{"t": t, "T": c, "shutter": "closed"} for t in (1.0, 3.0, 10.0) for c in (20.0, 25.0, 30.0)]
    plan = [*darks, *darks, *({"t": t} for t in (1e-3, 3e-3, 5e-3) for _ in range(2))]
    captured = make_capture(4, extra_e=lambda s: leak * 2.0 ** ((s["T"] - 25.0) / 6.0) * s["t"], plan=plan)
    state = _with(DarkCurrentNonuniformity(2.0, doubling_K=7.2), captured, DarkCurrent(3.0))
    tests = localise(state)
    form = loosened(state, None if significant(tests) else departing(tests, state.effects))
    assert (form is not None) is uneven
    if form is not None:
        found = fitted_parameters(form)["dark_current_nonuniformity"]
        sigma = found["sigma_e_per_s"].value
        rise, bend = np.polynomial.legendre.legfit(down[:, 0], np.broadcast_to(more, (64, 1))[:, 0], 2)[1:]
        side = 64 / 96  # y runs from −1 to 1 over the longer side
        rises = (("rise_y", rise / sigma / side), ("bend_y", 1.5 * bend / sigma / side**2))
        for name, truth in (*rises, ("rise_x", 0.0), ("bend_x", 0.0)):
            assert abs(found[name].value - truth) < 4.0 * float(found[name].u or 0.0) < 0.5


@pytest.mark.slow
def test_what_was_named_too_early_gives_way(make_capture):
    """Next to the veil that was found later, an offset of 0.9 DN is likelier than the exponent named for it."""
    captured = make_capture(picture=lambda image, s: 0.98 * image + 0.02 * image.mean(), extra_dn=lambda s: 0.9)
    early = _with(GammaEnabled(1.002), captured, VeilingGlare(0.02))
    state, taken = swapped(early, {"gamma_enabled": (BlackLevelOffset(0.5),)})
    assert [*taken] == ["gamma_enabled"]
    assert {effect.name for effect in state.effects} == {"veiling_glare", "black_level_offset"}
    offset = fitted_parameters(state)["black_level_offset"]["offset_dn"]
    assert offset.value == pytest.approx(0.9, abs=3.0 * offset.u)
    assert swapped(state, {"black_level_offset": (GammaEnabled(1.002),)}) == (state, {})
