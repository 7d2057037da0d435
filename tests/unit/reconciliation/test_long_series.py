"""A long series of equal frames: captures of a few frames each, cut where it jumps, and what is found in time."""

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry
from radiometer.reconciliation.engine import jumps
from radiometer.reconciliation.measure.design import Design, group_captures
from testing.reconciled import reconcile

BLACK, E_PER_DN, NOISE_E = 200.0, 2.0, 3.0
STATED = {"conversion_gain_e_per_dn": E_PER_DN, "read_noise_e": NOISE_E, "full_well_e": 3e4, "black_level_dn": BLACK}


def header(count, *, timed=True, shutter="open", known=True, **more):
    frames = tuple(
        FrameEntry(
            file=f"{k}.png",
            exposure_s=0.012,
            timestamp_s=0.5 * k if timed else None,
            shutter=shutter,
            gain_db=0.0,
            **more,
        )
        for k in range(count)
    )
    camera = CameraDescription(bit_depth=14, pixel_pitch_um=12.0, **(STATED if known else {}))
    return CaptureHeader(camera=camera, frames=frames)


def series(level, count, *, offset, seed):
    """Return pictures of a scene whose light goes by a law of the time in s, on a black level that does."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:48, :64]
    scene = 1.0 + 0.2 * np.exp(-(np.square(x - 20.0) + np.square(y - 20.0)) / 450.0)
    found = []
    for k in range(count):
        electrons = rng.poisson(level(0.5 * k) * scene * E_PER_DN) + NOISE_E * rng.standard_normal(scene.shape)
        found.append(np.rint(electrons / E_PER_DN + BLACK + offset(0.5 * k)).astype(np.uint16))
    return found


def asked(head, pictures):
    frames = [Frame(dn, 14, entry.settings) for dn, entry in zip(pictures, head.frames, strict=True)]
    return reconcile(head, frames, with_limits=False)


def test_a_long_series_is_cut_into_captures_of_four_and_more():
    """Sixteen frames make four captures, a thousand no more than 64; none is left out and none stands twice."""
    assert [len(one.frames) for one in group_captures(header(16))] == [4, 4, 4, 4]
    many = group_captures(header(1000))
    assert len(many) == 64
    assert {len(one.frames) for one in many} == {15, 16}
    assert [frame for one in many for frame in one.frames] == list(range(1000))


@pytest.mark.parametrize("head", [header(15), header(100, timed=False)])
def test_a_short_series_and_one_without_times_stay_whole(head):
    """What does not tell the time is one capture of one setting."""
    assert [len(one.frames) for one in group_captures(head)] == [len(head.frames)]


def test_a_series_among_many_settings_stays_whole():
    """Twenty series of 40 frames have their own covariates: 64 pieces would be three for each."""
    frames = [entry.model_copy(update={"exposure_s": 0.01 * (1 + n)}) for n in range(20) for entry in header(40).frames]
    head = header(1).model_copy(update={"frames": tuple(frames)})
    assert [len(one.frames) for one in group_captures(head)] == [40] * 20


def test_captures_begin_where_a_series_jumps():
    """Parts on either side are cut in proportion; a jump in front of the first frame is none."""
    pieces = [one.frames for one in group_captures(header(40), (0, 13))]
    assert 13 in [frames[0] for frames in pieces]
    assert not any(12 in frames and 13 in frames for frames in pieces)
    assert sorted(frame for frames in pieces for frame in frames) == list(range(40))
    assert len(pieces) == 10


def found_at(level):
    """Return the jumps of a series whose frames have these levels, in 24 tiles of noise 0.1."""
    noise = 0.1 * np.random.default_rng(4).standard_normal((level.size, 24))
    return jumps(
        Design.of(header(level.size), (48, 64)), lambda frames: level[list(frames), None] + noise[list(frames)]
    )


def test_jumps_are_reported_and_lone_frames_are_none():
    """A step of 1 at frame 33, an event at 21 that dies away over ten frames; a flash, a drift and nothing are none."""
    k = np.arange(80)
    assert found_at(1.0 * (k >= 33)) == (33,)
    assert found_at(2.0 * np.where(k >= 21, np.exp(-(k - 21) / 10.0), 0.0)) == (21,)
    assert found_at(1.0 * (k >= 20) - 1.0 * (k >= 50)) == (20, 50)
    assert found_at(2.0 * (k == 33)) == ()
    assert found_at(0.05 * k) == ()
    assert found_at(0.0 * k) == ()


@pytest.mark.slow
@pytest.mark.parametrize("lit", [True, False])
def test_an_event_within_a_series_is_named_with_its_time(lit):
    """A camera zeroes itself at 30.2 s: 12 DN that relax within 8 s, in light and in the dark."""
    head = header(120, shutter="open" if lit else "closed")
    law = lambda t: 12.0 * np.exp(-(t - 30.2) / 8.0) if t > 30.2 else 0.0  # noqa: E731
    found = asked(head, series(lambda t: 900.0 if lit else 0.0, 120, offset=law, seed=41))
    assert str(found.verdict) == "effects_found"
    (event,) = found.effects
    assert event.name == "event_offset"
    size, tau = event.parameters["offset_dn"], event.parameters["tau_s"]
    assert size.value == pytest.approx(law(30.5), abs=3.5 * size.u)
    assert tau.value == pytest.approx(8.0, abs=3.5 * tau.u)


@pytest.mark.slow
def test_a_lamp_that_jumps_within_a_series_is_named():
    """Light that is 1 % brighter from 31.5 s on is no event of the camera: bright tiles rise by more."""
    found = asked(header(120), series(lambda t: 909.0 if t > 31.2 else 900.0, 120, offset=lambda t: 0.0, seed=42))
    assert str(found.verdict) == "effects_found"
    (step,) = found.effects
    assert step.name == "lamp_step"
    size = step.parameters["step_rel"]
    assert size.value == pytest.approx(0.01, abs=3.5 * size.u)


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_a_quiet_series_agrees(known):
    """Also without a statement of the camera: its black level is taken from the noise, and that is stated."""
    found = asked(header(120, known=known), series(lambda t: 900.0, 120, offset=lambda t: 0.0, seed=43))
    assert str(found.verdict) == "agrees"
    assert any("noise of the light extrapolates" in line for line in found.assumptions) is not known
