"""The finder against sessions of the independent generator: what is hidden is named, and nothing else is.

`python -m benchmarks.reconcile_confusion` runs the whole matrix; here stands one session of each kind of cause.
"""

from __future__ import annotations

import warnings

import pytest

from benchmarks.reconcile_limits import FIRST_SEED, answer_at, is_named
from radiometer.data import TapDescription
from radiometer.reconciliation.result import Limit, ReconcileResult
from testing.generator.other_laws import OTHER_LAWS, session_of
from testing.generator.rig import Rig
from testing.generator.session import Session, make_session, session_of_taps
from testing.reconciled import gaps_of, reconcile

pytestmark = pytest.mark.timeout(600)
laws_left_out = pytest.mark.usefixtures("laws_left_out")


def answer(
    session: Session, without: tuple[str, ...] = (), *, with_limits: bool = False, **header: object
) -> ReconcileResult:
    """Return what is found in a session, its header changed, without some entries of the catalogue."""
    stated = session.header.model_copy(update=header)
    return reconcile(stated, list(session.frames()), without=without, with_limits=with_limits)


def names(found: ReconcileResult) -> list[str]:
    """Return the names of the effects in their order."""
    return [effect.name for effect in found.effects]


def assert_alone(found: ReconcileResult, name: str) -> None:
    """Assert that a name is given, and no other."""
    assert (str(found.verdict), names(found)) == ("effects_found", [name])


def assert_size(found: ReconcileResult, parameter: str, true: float, *, us: float = 4.0, allowed: float = 0.0) -> None:
    """Assert that a parameter of the first effect is the true one within some of its u, or what is allowed."""
    fitted = found.effects[0].parameters[parameter]
    assert fitted.value == pytest.approx(true, abs=allowed or us * fitted.u)


# Rich sessions with stated patches.

# One cause of each kind: electronics, noise, optics, lens scale; timing and source have tests of their own below.
SAMPLE = ("dark_current", "excess_read_noise", "veiling_glare", "fnumber_tstop_error")


def test_nothing_hidden_nothing_found():
    """A session without any hidden effect agrees with the camera that its header declares."""
    found = answer(make_session(camera_seed=0))
    assert (str(found.verdict), found.effects) == ("agrees", ())


@laws_left_out
@pytest.mark.parametrize("name", SAMPLE)
def test_hidden_effect_is_named_first(name):
    """At its smallest realistic size the effect is the first name given, and the gap on held-out settings shrinks."""
    found = answer(make_session(name, camera_seed=3))
    assert names(found)[:1] == [name]
    assert found.gap_after < found.gap_before


@pytest.mark.parametrize(
    ("name", "seed", "plan"),
    [
        # What several statistics show (flicker in first frames, charge at edges) is one name, and nothing stays.
        *((name, 1000, {}) for name in ("mains_ripple", "brighter_fatter", "random_telegraph_noise")),
        # Two frames per capture: lag makes the first one darker, a ripple either.
        *(
            (name, seed, {"plan": "bracket", "frames": 2})
            for name, seed in (("image_lag", 2438361), ("mains_ripple", 2439003))
        ),
        # A negative power up to a threshold is no lamp that settles within the exposure.
        ("reciprocity_failure:short_only", 401, {}),
    ],
)
def test_hidden_effect_is_named_alone(name, seed, plan):
    """Whatever else it looks like: the effect is named, and no other."""
    assert_alone(answer(make_session(name, camera_seed=seed, **plan)), name.partition(":")[0])


@laws_left_out
@pytest.mark.parametrize(
    ("form", "parameter", "allowed"),
    [
        ("adc_saturation:clamped_bits", ("clip_dn", "clip_dn"), 1.0),
        ("black_level_offset:taken_off", ("offset_dn", "offset_dn"), 0.5),
        ("pwm_flicker:refresh", ("frequency_hz", "frequency_Hz"), 0.0),
        ("dark_frame_subtracted", ("share", "share"), 0.0),
        ("dark_frame_subtracted:cut", ("share", "share"), 0.0),
    ],
)
def test_hidden_processing_and_a_panel_s_beat_are_named(form, parameter, allowed):
    """Bits cut off, a black level taken off and cut at zero, a panel's refresh, darks subtracted: right name and size.

    Codes within one of rounding, a frequency and the share of the darks' noise within four of their u.
    """
    session = make_session(form, camera_seed=5201, scale=2.0)
    found = answer(session)
    assert names(found)[0] == form.partition(":")[0]
    assert len(found.effects) <= (2 if "taken_off" in form else 1)  # what is taken off lowers the highest code, too
    assert_size(found, parameter[0], session.truth[form][parameter[1]], allowed=allowed)


SERIES = {
    "lamp_step": ("step_rel", "step"), "first_frame_offset": ("offset_dn", "offset_dn"),
    "readout_dark_charge": ("doubling_K", "doubling_K"), "line_start_offset": ("decay_share", "decay_share"),
    "correlated_read_noise": ("sigma_e", "sigma_e"), "residual_charge": ("share", "share"),
    "event_offset": ("tau_s", "tau_s"), "row_dependent_exposure": ("added_s", "added_s"),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(SERIES))
def test_what_goes_on_between_frames_is_named_with_its_size(name, request):
    """A jumping lamp, unsettled first frames and lines, charge of readout or of traps: named alone, within four u."""
    if name != "lamp_step":
        request.getfixturevalue("laws_left_out")
    session = make_session(name, camera_seed=5101)
    found = answer(session)
    assert_alone(found, name)
    own, true = SERIES[name]
    assert_size(found, own, session.truth[name][true])


@laws_left_out
def test_a_leak_is_not_distinguished_from_rows_of_longer_exposure():
    """The same equation: the one of fewer parameters has the name, the other is next to it."""
    (found,) = answer(make_session("parasitic_light_sensitivity", camera_seed=5102)).effects
    assert found.name == "parasitic_light_sensitivity"
    assert "row_dependent_exposure" in found.alternatives


@laws_left_out
def test_a_bend_beyond_the_declared_full_well_keeps_its_name():
    """Pixels hold 1.7 times the declared full well: the bend is named, its size in that well, and the wrong well."""
    session = make_session("response_nonlinearity", camera_seed=5401, scale=3.0)
    camera = session.header.camera.model_copy(update={"full_well_e": 0.6 * session.header.camera.full_well_e})
    found = answer(session, camera=camera)
    assert str(found.verdict) == "effects_found"
    assert names(found) == ["response_nonlinearity", "full_well_saturation"]
    assert_size(found, "a2", 0.6 * session.truth["response_nonlinearity"]["a2"])
    assert found.effects[0].gap_after < 1.05


@laws_left_out
@pytest.mark.parametrize(
    ("form", "seed", "before_at_least"),
    [
        ("exposure_time_offset", 4, 1.1),
        ("black_level_drift:curved", 9500, 1.5),
        ("mechanical_vignetting:circles", 9500, 1.5),
    ],
)
def test_found_effect_shrinks_the_gap_of_a_fresh_session(form, seed, before_at_least):
    """With what was found frozen, another session of the same rig is met to a reduced chi-square of 1.05.

    Also where the hidden law is another than the catalogue's, a bent drift or a pupil cut by the barrel: it takes a
    flexible form.
    """
    found = answer(make_session(form, camera_seed=seed))
    assert names(found)[:1] == [form.partition(":")[0]]
    if seed != 4:
        assert_alone(found, form.partition(":")[0])
    fresh = make_session(form, camera_seed=seed, session_seed=904)
    before, after = gaps_of((None, found), fresh.header, list(fresh.frames()))
    assert before > before_at_least
    assert after <= 1.05


def test_entry_taken_from_the_catalogue_is_not_replaced_by_a_confident_name():
    """Without its entry the droop is left unnamed or provisional, and the source's level is among the first places."""
    found = answer(make_session("led_thermal_droop", camera_seed=5), without=("led_thermal_droop",))
    assert str(found.verdict) in ("unnamed_effect", "incomplete")
    places = list(dict.fromkeys(place["covariate"] for place in found.to_mapping()["localisation"]))
    assert "source_level" in places[:3]


@laws_left_out
def test_doubts_lead_back_to_where_another_entry_was_nearly_chosen():
    """A hard full well next to rounded exposures: a soft one leads at first, and ends with a label error next to it."""
    found = answer(make_session("exposure_quantisation:round", "full_well_saturation", camera_seed=33061))
    assert str(found.verdict) == "effects_found"
    assert sorted(names(found)) == ["exposure_quantisation", "full_well_saturation"]


# Several output amplifiers.


@pytest.mark.parametrize(
    ("name", "seed", "shape"),
    [
        ("tap_offset", 9411, (2, 2)), ("tap_gain", 9412, (2, 2)), ("tap_noise", 9413, (2, 2)),
        ("tap_nonlinearity", 9414, (2, 2)), ("half_timing", 9415, (2, 2)), ("amplifier_glow", 9416, (2, 2)),
        ("charge_transfer_inefficiency", 9417, (2, 2)),
        # Two rows of eight taps, each with its size; a third of the patches are read by two amplifiers each.
        ("tap_offset", 1301202, (2, 8)), ("tap_gain", 1301201, (2, 8)),
    ],
)  # fmt: skip
def test_an_amplifier_s_effect_is_named_alone(name, seed, shape):
    """Twice its smallest usual size in a rich session: the effect is named and nothing else is."""
    session = make_session(name, camera_seed=seed, scale=2.0) if shape == (2, 2) else session_of_taps(name, shape, seed)
    h, w = Rig().rows // shape[0], Rig().columns // shape[1]
    taps = tuple(TapDescription(name=f"{x}{y}", x=x * w, y=y * h, width=w, height=h)
                 for y in range(shape[0]) for x in range(shape[1]))  # fmt: skip
    assert names(answer(session, camera=session.header.camera.model_copy(update={"taps": taps}))) == [name]


# The right name where the catalogue's equation is wrong, and nothing else that only mends the equation.


def by_other_law(name: str, **plan: str) -> ReconcileResult:
    """Return what is found in a session whose hidden cause follows another law."""
    return answer(session_of(name, 1, **plan))


@pytest.mark.parametrize("name", ["halo", "prnu", "settling", "falling"])
def test_another_law_has_the_right_name_alone(name):
    """A halo with a power's wings, coarse pixels in small patches, light that settles or falls within each setting."""
    found = by_other_law(name)
    assert_alone(found, OTHER_LAWS[name][1])
    assert found.gap_after < 1.05


def test_a_field_cut_by_another_law_takes_a_free_one():
    """A barrel that is no two circles: one name, its law a table along radius and stop, and nothing is left."""
    result = by_other_law("barrel")
    (found,) = result.effects
    assert "mechanical_vignetting" in (found.name, *found.alternatives)
    assert list(found.curve.along) == ["field_radius", "f_number"]
    mapping = found.to_mapping()
    assert mapping["law"] == "other than the catalogue's"
    assert len(mapping["curve"]["factor"]) == len(mapping["curve"]["u"]) == 6 * 4
    assert result.gap_after < 1.02


def test_a_gamma_before_the_black_level_is_a_gamma():
    """Its name, not a handful of others that bend together; what is left is one entry."""
    assert names(by_other_law("gamma")) in (["gamma_enabled"], ["gamma_enabled", "unnamed"])


def test_chopped_light_is_a_flicker_and_every_fifth_frame_is_none():
    """Light that is off for a part of each period is a flicker; what comes back by the number of the frame is not."""
    (found,) = by_other_law("chopped").effects
    assert "pwm_flicker" in {found.name, *found.alternatives} <= {"mains_ripple", "pwm_flicker"}
    (found,) = by_other_law("fifth").effects
    assert (found.name, found.where) == ("unnamed", "frame")
    assert found.parameters["period_frames"].value == 5.0


# Brackets of a scene of which no patches are stated: borders of patches run through the tiles.


def of_a_scene(*hidden: str, seed: int = 80, with_limits: bool = False, **how: object) -> ReconcileResult:
    """Return what is found in a bracket whose header states no patches."""
    session = make_session(*hidden, camera_seed=seed, plan="bracket", **how)
    return answer(session, patches=(), with_limits=with_limits)


def test_unknown_scene_agrees_where_nothing_is_hidden():
    """Borders of patches are the scene, at every exposure alike, and no effect."""
    found = of_a_scene()
    assert str(found.verdict) == "agrees"
    assert found.gap_before < 1.05


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        # Timing, noise, codes, patterns of the sensor and what whole frames share need no patch.
        *(
            (one, 80)
            for one in ("exposure_time_offset", "excess_read_noise", "missing_codes", "column_pattern", "mains_ripple")
        ),
        # Lag leaves the last picture in the first frame of the next capture: no read noise.
        ("image_lag", 7610),
    ],
)
def test_unknown_scene_shows_what_needs_no_scene(name, seed):
    """The effect is named alone without any patch."""
    assert_alone(of_a_scene(name, seed=seed, **({"known_patches": False} if seed == 7610 else {})), name)


@laws_left_out
def test_flicker_seen_at_short_exposures_alone_has_two_names():
    """Below 1.4 ms a ripple of the mains and a dimmed source look alike: either is next to the other."""
    effect = of_a_scene("mains_ripple", seed=7610, known_patches=False).effects[0]
    assert {effect.name, *effect.alternatives} == {"mains_ripple", "pwm_flicker"}


def test_saturation_is_judged_by_the_even_part_of_a_cell():
    """Borders of patches run through the cells: the even part of each shows the full well, and its limit."""
    found = of_a_scene("full_well_saturation", seed=7610, with_limits=True, known_patches=False)
    assert names(found) == ["full_well_saturation"]
    assert found.effects[0].parameters["full_well_e"].value == pytest.approx(8430.08, abs=5.0)
    assert found.limits["full_well_saturation"].amplitude == pytest.approx(8430.08, abs=5.0)
    assert found.limits["exposure_time_offset"].amplitude is not None


@laws_left_out
def test_fit_that_goes_astray_takes_smaller_steps_and_says_nothing():
    """A gamma bends a free scene so much that a whole step would overflow: no warning reaches the terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = of_a_scene("gamma_enabled", seed=7500)
    assert "gamma_enabled" in names(found)
    assert found.gap_after < 0.01 * found.gap_before


# Other sensors: 8 bits, where rounding no longer averages out, and many pixels, whose noise is known very well.


EIGHT_BITS = Rig(bit_depth=8, e_per_dn=41.6, black_dn=15.0)  # noise of 0.06 codes: dark means lie on whole codes
LARGER = Rig(rows=320, columns=432, spacing_um=15.0)  # tiles of 3,800 pixels, fifteen times those of the other tests


@pytest.mark.parametrize(("rig", "seed"), [(EIGHT_BITS, 12_000), (LARGER, 2)])
def test_nothing_is_found_in_coarse_codes_or_large_frames(rig, seed):
    """The model rounds as the camera does; the finer eye of many pixels sees nothing where nothing is."""
    found = answer(make_session(camera_seed=seed, rig=rig, plan="short"))
    assert str(found.verdict) == "agrees"
    assert rig is LARGER or found.gap_before < 1.05


@pytest.mark.parametrize(
    ("name", "parameter", "true", "how"),
    [
        # By one to two codes, through the rounding.
        ("black_level_offset", "offset_dn", "offset_dn", {"camera_seed": 12_001, "rig": EIGHT_BITS, "plan": "bracket"}),
        # The stated radiances bend to a veil; with it they come back, and the noise of the dark patches too.
        ("veiling_glare", "share", "fraction", {"camera_seed": 1, "rig": LARGER, "plan": "short"}),
    ],
)
def test_other_sensors_show_an_effect_with_its_size(name, parameter, true, how):
    """Named alone, its size within three u."""
    session = make_session(name, **how)
    found = answer(session)
    assert names(found) == [name]
    assert_size(found, parameter, session.truth[name][true], us=3.0)


# The table of limits: what lies below is not named, what lies well above is.


@pytest.fixture(scope="module")
def stated() -> dict[str, Limit]:
    """Return the limits that a plain bracket states where nothing is hidden."""
    return dict(answer(make_session(camera_seed=FIRST_SEED, plan="bracket"), with_limits=True).limits)


# One entry of each block: mean, variance, spatial variance, columns, first frame, edge.
@pytest.mark.parametrize(
    "name", ["black_level_offset", "excess_read_noise", "prnu", "column_pattern", "image_lag", "psf_blur"]
)
def test_half_the_limit_stays_hidden_and_twice_is_named(name, stated):
    """A limit is five sigma and a name asks for about four: 2.5 sigma (less, where it grows faster) pass, 10 do not."""
    limit = stated[name].amplitude
    assert not is_named(name, answer_at(name, 0.5 * limit, FIRST_SEED, "bracket"))
    assert is_named(name, answer_at(name, 2.0 * limit, FIRST_SEED, "bracket"))


def test_named_effect_keeps_its_limit(stated):
    """What is named has the limit of data without it, not a share of its own uncertainty."""
    found = answer(make_session("psf_blur", camera_seed=FIRST_SEED, plan="bracket"), with_limits=True)
    assert names(found) == ["psf_blur"]
    assert found.limits["psf_blur"].amplitude == pytest.approx(stated["psf_blur"].amplitude, rel=0.2)
