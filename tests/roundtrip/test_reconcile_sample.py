"""A sample of the confusion matrix: the finder against sessions of the independent generator.

`python -m benchmarks.reconcile_confusion` runs all of it; here stands one session of each kind of cause.
"""

from __future__ import annotations

import pytest

from radiometer.reconciliation.result import ReconcileResult
from testing.generator.session import Session, make_session
from testing.reconciled import gaps_of, reconcile

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

# One cause of each kind: electronics, noise, optics, lens scale; timing and source have tests of their own below.
SAMPLE = ("dark_current", "excess_read_noise", "veiling_glare", "fnumber_tstop_error")


def _ask(session: Session, without: tuple[str, ...] = ()) -> ReconcileResult:
    return reconcile(session.header, list(session.frames()), without=without, with_limits=False)


def test_nothing_hidden_nothing_found():
    """A session without any hidden effect agrees with the camera that its header declares."""
    answer = _ask(make_session(camera_seed=0))
    assert str(answer.verdict) == "agrees"
    assert answer.effects == ()


@pytest.mark.usefixtures("laws_left_out")
@pytest.mark.parametrize("name", SAMPLE)
def test_hidden_effect_is_named_first(name):
    """At its smallest realistic size the effect is the first name given, and the gap on held-out settings shrinks."""
    answer = _ask(make_session(name, camera_seed=3))
    assert [e.name for e in answer.effects][:1] == [name]
    assert answer.gap_after < answer.gap_before


@pytest.mark.parametrize("name", ["mains_ripple", "brighter_fatter", "random_telegraph_noise"])
def test_hidden_effect_is_named_alone(name):
    """What several statistics show (flicker in first frames, charge at edges) is one name, and nothing stays."""
    answer = _ask(make_session(name, camera_seed=1000))
    assert str(answer.verdict) == "effects_found"
    assert [e.name for e in answer.effects] == [name]


@pytest.mark.parametrize(("name", "seed"), [("image_lag", 2438361), ("mains_ripple", 2439003)])
def test_the_order_of_two_frames_is_no_chance_and_chance_no_order(name, seed):
    """Two frames per capture: lag makes the first one darker, a ripple either; each is one name."""
    answer = _ask(make_session(name, camera_seed=seed, plan="bracket", frames=2))
    assert str(answer.verdict) == "effects_found"
    assert [e.name for e in answer.effects] == [name]


@pytest.mark.usefixtures("laws_left_out")
@pytest.mark.parametrize(
    ("form", "parameter", "allowed"),
    [
        ("adc_saturation:clamped_bits", ("clip_dn", "clip_dn"), 1.0),
        ("black_level_offset:taken_off", ("offset_dn", "offset_dn"), 0.5),
        ("pwm_flicker:refresh", ("frequency_hz", "frequency_Hz"), None),
        ("dark_frame_subtracted", ("share", "share"), None),
        ("dark_frame_subtracted:cut", ("share", "share"), None),
    ],
)
def test_hidden_processing_and_a_panel_s_beat_are_named(form, parameter, allowed):
    """Bits cut off, a black level taken off and cut at zero, a panel's refresh, darks subtracted: right name and size.

    Codes within one of rounding, a frequency and the share of the darks' noise within four of their u.
    """
    session = make_session(form, camera_seed=5201, scale=2.0)
    answer = _ask(session)
    found = answer.effects[0]
    assert found.name == form.partition(":")[0]
    assert len(answer.effects) <= (2 if "taken_off" in form else 1)  # what is taken off lowers the highest code, too
    fitted = found.parameters[parameter[0]]
    assert fitted.u is not None
    assert fitted.value == pytest.approx(session.truth[form][parameter[1]], abs=allowed or 4.0 * fitted.u)


@pytest.mark.usefixtures("laws_left_out")
def test_a_bend_beyond_the_declared_full_well_keeps_its_name():
    """Pixels hold 1.7 times the declared full well: the bend is named, its size in that well, and the wrong well."""
    session = make_session("response_nonlinearity", camera_seed=5401, scale=3.0)
    camera = session.header.camera.model_copy(update={"full_well_e": 0.6 * session.header.camera.full_well_e})
    answer = reconcile(session.header.model_copy(update={"camera": camera}), list(session.frames()), with_limits=False)
    assert str(answer.verdict) == "effects_found"
    found, well = answer.effects
    assert (found.name, well.name) == ("response_nonlinearity", "full_well_saturation")
    bend = found.parameters["a2"]
    assert bend.u is not None
    assert bend.value == pytest.approx(0.6 * session.truth["response_nonlinearity"]["a2"], abs=4.0 * bend.u)
    assert found.gap_after < 1.05


@pytest.mark.usefixtures("laws_left_out")
def test_found_effect_shrinks_the_gap_of_a_fresh_session():
    """With what was found frozen, another session of the same rig is met to a reduced chi-square of 1.05."""
    answer = _ask(make_session("exposure_time_offset", camera_seed=4))
    assert [e.name for e in answer.effects][:1] == ["exposure_time_offset"]
    fresh = make_session("exposure_time_offset", camera_seed=4, session_seed=904)
    before, after = gaps_of((None, answer), fresh.header, list(fresh.frames()))
    assert before > 1.1
    assert after <= 1.05


def test_power_of_short_times_alone_keeps_its_name():
    """A negative power up to a threshold is no lamp that settles within the exposure."""
    answer = _ask(make_session("reciprocity_failure:short_only", camera_seed=401))
    assert [e.name for e in answer.effects] == ["reciprocity_failure"]


@pytest.mark.usefixtures("laws_left_out")
@pytest.mark.parametrize("form", ["black_level_drift:curved", "mechanical_vignetting:circles"])
def test_other_equation_of_an_effect_takes_a_flexible_form(form):
    """A bent drift and a pupil cut by the barrel keep their names, alone, and a fresh session is met to 1.05."""
    answer = _ask(make_session(form, camera_seed=9500))
    assert str(answer.verdict) == "effects_found"
    assert [e.name for e in answer.effects] == [form.partition(":")[0]]
    fresh = make_session(form, camera_seed=9500, session_seed=904)
    before, after = gaps_of((None, answer), fresh.header, list(fresh.frames()))
    assert before > 1.5
    assert after <= 1.05


def test_entry_taken_from_the_catalogue_is_not_replaced_by_a_confident_name():
    """Without its entry the droop is left unnamed or provisional, and the source's level is among the first places."""
    answer = _ask(make_session("led_thermal_droop", camera_seed=5), without=("led_thermal_droop",))
    assert str(answer.verdict) in ("unnamed_effect", "incomplete")
    places = list(dict.fromkeys(place["covariate"] for place in answer.to_mapping()["localisation"]))
    assert "source_level" in places[:3]


@pytest.mark.usefixtures("laws_left_out")
def test_doubts_lead_back_to_where_another_entry_was_nearly_chosen():
    """A hard full well next to rounded exposures: a soft one leads at first, and ends with a label error next to it."""
    hidden = ("exposure_quantisation:round", "full_well_saturation")
    answer = _ask(make_session(*hidden, camera_seed=33061))
    assert str(answer.verdict) == "effects_found"
    assert sorted(e.name for e in answer.effects) == ["exposure_quantisation", "full_well_saturation"]
