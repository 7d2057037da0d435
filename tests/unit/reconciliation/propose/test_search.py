"""Laws are found in sessions of the outside generators: stage, covariates, size, and what is written of them."""

import numpy as np
import pytest

from radiometer.data import CaptureSet
from radiometer.reconciliation.descent import first_state
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.propose import propose_law, search
from radiometer.reconciliation.propose.grammar import Term
from radiometer.reconciliation.propose.law import Law, effect_of
from radiometer.reconciliation.propose.search import own_covariates
from radiometer.reconciliation.reduce import reduce_frames
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.display_nonuniformity import DisplayNonuniformity
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from testing.generator.session import make_session
from testing.outside import two
from testing.outside.two_hidden import HIDDEN


def state_of(folder, seed, name, plan, given=(), **more):
    """Return the starting camera fitted to a session that hides something."""
    session = two.make(seed, HIDDEN.get(name), plan, **more)
    captured = CaptureSet.read(session.write(folder))
    design = Design.of(captured.header, captured.read_frame(0).shape)
    return first_state(design, *reduce_frames(design, captured.read_frame), given), session


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "along", "law", "parameter", "drawn"),
    [
        ("gain_noise", "signal", "tremble_constant", "amplitude", "depth"),
        *(pytest.param(*row, marks=pytest.mark.long) for row in (
            ("smear", "column_light", "transfer_proportion_of_column", "amplitude_s", "shift_s"),
            ("stop_hysteresis", "f_number", "optics_two_of_stop", "amplitude", "error"),
        )),
    ],
)  # fmt: skip
def test_a_law_of_columns_of_noise_and_of_some_stops(name, along, law, parameter, drawn, tmp_path):
    """What the tests' own generator hid is found at its size, within four of its u."""
    made = make_session(name, camera_seed=71, session_seed=72, plan="rich")
    captured = made.write(tmp_path / "set")
    design = Design.of(captured.header, captured.read_frame(0).shape)
    proposal = propose_law(first_state(design, *reduce_frames(design, captured.read_frame)), along=(along,))
    assert proposal.name == law
    assert along in proposal.covariates
    found = proposal.parameters[parameter]
    assert abs(found.value - made.truth[name][drawn]) < 4.0 * found.u


@pytest.mark.slow
def test_a_first_look_sees_a_gain_between_patches_whose_radiances_make_room(tmp_path):
    """A gain that steps between two rows of patches is no error of their radiances: their noise says so from the start.

    The nuisances take the noise along with the light; a law whose own change of it did not count came out at a sixth.
    """
    state, session = state_of(tmp_path / "set", 74022, "row_gain_step", "levels")
    row = Law("gain", (Term("border", "image_y", {}, {"at": 57.0 / session.frames[0].shape[1]}),))
    light = Law("optics", row.terms)
    as_gain, as_light = search.screened(state, [row, light])
    assert as_gain.amplitude == pytest.approx(session.secret.drawn["step"], rel=0.1)
    assert as_gain.gain > as_light.gain + 100.0


@pytest.fixture(scope="module")
def glow(tmp_path_factory):
    """Return the law proposed for an amplifier's glow in darks, and the secret."""
    state, session = state_of(tmp_path_factory.mktemp("glow") / "set", 11, "corner_glow", "darks")
    return propose_law(state), session


@pytest.mark.slow
def test_a_glow_is_found_and_reported_in_one_sentence(glow):
    """Stage, place and width within four of their u; what acts, how it scales, along what."""
    proposal, session = glow
    side, drawn = session.frames[0].shape[1], session.secret.drawn
    assert (proposal.stage, proposal.stages_alike) == ("charge", ())
    assert proposal.covariates == ("image_x", "image_y", "exposure_s")
    width = proposal.parameters["width_x"]
    assert abs(width.value - drawn["width_px"] / side) < 4.0 * width.u
    assert proposal.parameters["at_x"].value == pytest.approx(drawn["x_px"] / side, abs=0.02)
    assert proposal.closed > 0.95
    assert proposal.law.size == 4
    drawn, (height, width) = glow[1].secret.drawn, glow[1].frames[0].shape
    row = "upper" if drawn["y_px"] < height / 2 else "lower"
    column = "left" if drawn["x_px"] < width / 2 else "right"
    assert glow[0].sentence() == (
        f"adds charge in proportion to exposure, falling off as a Gaussian from the {row} {column} corner: like the "
        "glow of an amplifier or heat next to the sensor"
    )


@pytest.mark.slow
def test_laws_that_hold_in_another_session_only(glow, tmp_path):
    """Nine tenths of what it lacks are closed; where nothing is hidden nothing is proposed."""
    effect = effect_of(glow[0].law, glow[0].amplitude)
    before, _ = state_of(tmp_path / "before", 11, "corner_glow", "darks", again=1)
    after, _ = state_of(tmp_path / "after", 11, "corner_glow", "darks", (effect,), again=1)
    assert after.gap - 1.0 < 0.1 * (before.gap - 1.0)
    state, _ = state_of(tmp_path / "set", 13, None, "bracket")
    assert propose_law(state) is None


@pytest.mark.slow
def test_what_a_rest_does_to_the_black_level_is_seen(tmp_path):
    """The time since the last frame is a covariate, though no header says so."""
    state, session = state_of(tmp_path / "set", 12, "idle_black", "darks")
    proposal = propose_law(state)
    assert proposal.stage == "digital"
    assert proposal.covariates == ("since_frame_s",)
    tau = proposal.parameters["tau_rest_s"]
    assert abs(tau.value - session.secret.drawn["tau_s"]) < 4.0 * tau.u


@pytest.mark.long
def test_a_lamp_that_dims_each_fifth_frame_gets_a_law_of_the_frames(tmp_path):
    """Which frame of five, and by how much: the source's light, in frames as they were taken."""
    state, session = state_of(tmp_path / "set", 66004, "every_fifth_dim", "flats")
    proposal = propose_law(state)
    assert (proposal.stage, proposal.covariates) == ("source", ("frame",))
    assert proposal.parameters["period_frame"].value == 5.0
    size = proposal.parameters["amplitude"]
    assert abs(size.value + session.secret.drawn["depth"]) < 4.0 * size.u
    assert proposal.closed > 0.95


@pytest.mark.slow
def test_the_time_since_the_last_frame_is_reported_of_first_and_other_frames(glow):
    """The first frame of a capture waited since the last of the one before; of all frames the first is infinite."""
    design = glow[0].before.design
    first, later = design.since_frame_s
    stamps = [entry.timestamp_s for entry in design.header.frames]
    assert np.isinf(first[0])
    one = design.captures[1].frames
    assert first[1] == pytest.approx(stamps[one[0]] - stamps[one[0] - 1])
    assert later[1] == pytest.approx((stamps[one[-1]] - stamps[one[0]]) / (len(one) - 1))


# Names are held to laws of no entry.


@pytest.mark.parametrize(
    ("effect", "along"),
    [
        (LedThermalDroop(), {"source_level"}),
        (ResponseNonlinearity(), {"signal", "value"}),
        (DarkCurrent(), {"temperature_C"}),  # what is not in proportion to the exposure is no current
        *((kind(), {"image_x", "image_y"}) for kind in (DisplayNonuniformity, NaturalVignetting)),
        (MechanicalVignetting(), {"image_x", "image_y", "f_number"}),
    ],
)
def test_the_covariates_of_laws_for_what_an_entry_goes_with(effect, along):
    """The charge and what the amplifier makes of it are one; a radius or a place of the screen is of the picture."""
    assert set(own_covariates(effect)) == along
