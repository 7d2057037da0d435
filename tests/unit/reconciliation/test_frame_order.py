"""What comes back every so many frames, and what is left without a name as one entry with its size."""

from itertools import count

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry, FrameSettings
from radiometer.reconciliation.design import Design, group_captures
from radiometer.reconciliation.engine import examine, jumps
from radiometer.reconciliation.repeatability import FrameLight, periodic
from testing.reconciled import reconcile

EXPOSURES = [{"t": float(t)} for t in np.geomspace(2e-4, 5e-3, 7)]
DARKS = [{"t": t, "shutter": "closed"} for t in (1e-4, 1e-2)]


def _seen(make_capture, light, frames=4, darks=0):
    """Return what is found in frames of a hundred electrons of noise, the light of each as stated.

    Where the last captures are darks, the settings before are twice as long as these.
    """
    base = make_capture(seed=51, frames=1, plan=[{"t": 3e-3}])
    header, picture = base.header, base.frames[0].dn.astype(np.float64)
    rng = np.random.default_rng(52)
    taken, entries = [], []
    for number in range(14 * frames):
        value = 64.0 + (picture - 64.0) * light(number) + rng.normal(0.0, 3.0, picture.shape)
        is_dark = number >= (14 - darks) * frames
        step = number // (frames if is_dark or not darks else 2 * frames)
        settings = FrameSettings(
            1e-3 * (1 + step), 0.0, 4.0, 64.0, 35.0, float(number), 0.9, "chart", "closed" if is_dark else "open"
        )
        entries.append(FrameEntry.of(f"{number}.png", settings))
        taken.append(Frame(np.clip(np.rint(value), 0, 4095).astype(np.uint16), 12, settings, number))
    design = Design.of(header.model_copy(update={"frames": tuple(entries)}), picture.shape)
    reader = FrameLight(design, taken.__getitem__)
    for number in range(len(taken)):
        reader(number)
    captures, tiles = len(design.captures), len(design.tiles)
    return periodic(design, reader, np.full(captures, 1e-9), np.ones((captures, tiles), np.bool_))


@pytest.mark.parametrize("period", [3, 5, 7])
def test_every_nth_frame_that_is_dim_is_found(make_capture, period):
    """A loss of 4 % in each n-th frame is found with its period and its depth to a tenth, wandering lamp or not."""
    rng = np.random.default_rng(period)
    found = _seen(make_capture, lambda n: (0.96 if n % period == 1 else 1.0) * (1.0 + 1e-3 * rng.standard_normal()))
    assert found.period == period
    assert found.depth == pytest.approx(0.04, abs=0.004)
    assert found.rms == pytest.approx(0.04 * np.sqrt(period - 1) / period, rel=0.1)


@pytest.mark.slow
def test_lamp_that_wanders_at_random_has_no_period(make_capture):
    """Of 40 lamps that wander by 2 % from frame to frame none has a period, at a chance of 0.1 % each."""
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        found.append(_seen(make_capture, lambda n, rng=rng: 1.0 + 0.02 * rng.standard_normal()))
    assert [entry for entry in found if entry is not None] == []


def test_first_frames_and_drifts_within_a_setting_have_no_period(make_capture):
    """What goes with the place in the series is another matter, also at twice the length of a series."""
    assert _seen(make_capture, lambda n: 0.95 if n % 4 == 0 else 1.0) is None
    assert _seen(make_capture, lambda n: 1.0 - 0.01 * (n % 4)) is None
    assert _seen(make_capture, lambda n: 0.95 if n % 8 == 0 else 1.0, darks=6) is None


@pytest.mark.slow
def test_every_fifth_frame_dim_does_not_agree(make_capture):
    """Of a source about which nothing is stated: the period is reported and no flicker next to it."""
    frames = count()
    captured = make_capture(
        seed=53, plan=[*EXPOSURES, *EXPOSURES, *DARKS],
        extra_e=lambda s: 0.0, exposure=lambda t: t * (0.94 if next(frames) % 5 == 2 else 1.0),
    )  # fmt: skip
    source = captured.header.source.model_copy(update={"reproducibility_u_rel": None})
    header = captured.header.model_copy(update={"source": source})
    result = reconcile(header, captured.frames, with_limits=False)
    assert str(result.verdict) == "unnamed_effect"
    (rest,) = result.effects
    assert (rest.where, rest.block, rest.probability) == ("frame", "common", None)
    assert rest.gain_nats > 7.0
    assert rest.parameters["period_frames"].value == 5.0
    assert rest.parameters["depth_rel"].value == pytest.approx(0.06, abs=0.005)


@pytest.mark.long
def test_rest_is_one_entry_with_its_size(make_capture):
    """A scatter of captures by an unknown cause is one entry; its root mean square is that of what was added."""
    plan = [*EXPOSURES, *EXPOSURES, *EXPOSURES, *EXPOSURES, *DARKS]
    number = count()
    waves = [6.0 * np.sin(2.0 * np.pi * (n // 4) / 9.0) for n in range(4 * len(plan))]
    captured = make_capture(seed=54, plan=plan, extra_dn=lambda s: waves[next(number)])
    design_frames = captured.frames
    done = examine(captured.header, design_frames.__getitem__, design_frames[0].shape, with_limits=False)
    unnamed = [effect for effect in done.result.effects if effect.name == "unnamed"]
    assert len(unnamed) == 1
    assert unnamed[0].parameters["rms_dn"].value == pytest.approx(6.0 / np.sqrt(2.0), rel=0.3)
    e_per_dn = 2.6
    ratio = unnamed[0].parameters["rms_e"].value / unnamed[0].parameters["rms_dn"].value
    assert ratio == pytest.approx(e_per_dn, rel=0.01)
    assert done.result.global_p[0] < 1e-6


# A long series of equal frames is cut where it jumps.


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


def test_long_series_are_cut_where_they_jump():
    """Four to 64 captures of which none is lost; among many settings a series stays whole."""
    assert [len(one.frames) for one in group_captures(header(16))] == [4, 4, 4, 4]
    many = group_captures(header(1000))
    assert len(many) == 64
    assert {len(one.frames) for one in many} == {15, 16}
    assert [frame for one in many for frame in one.frames] == list(range(1000))
    frames = [entry.model_copy(update={"exposure_s": 0.01 * (1 + n)}) for n in range(20) for entry in header(40).frames]
    head = header(1).model_copy(update={"frames": tuple(frames)})
    assert [len(one.frames) for one in group_captures(head)] == [40] * 20
    pieces = [one.frames for one in group_captures(header(40), (0, 13))]
    assert 13 in [frames[0] for frames in pieces]
    assert not any(12 in frames and 13 in frames for frames in pieces)
    assert sorted(frame for frames in pieces for frame in frames) == list(range(40))
    assert len(pieces) == 10


@pytest.mark.parametrize("head", [header(15), header(100, timed=False)])
def test_a_short_series_and_one_without_times_stay_whole(head):
    """What does not tell the time is one capture of one setting."""
    assert [len(one.frames) for one in group_captures(head)] == [len(head.frames)]


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
@pytest.mark.usefixtures("laws_left_out")
def test_a_lamp_that_jumps_within_a_series_is_named():
    """Light that is 1 % brighter from 31.5 s on is no event of the camera: bright tiles rise by more."""
    found = asked(header(120), series(lambda t: 909.0 if t > 31.2 else 900.0, 120, offset=lambda t: 0.0, seed=42))
    assert str(found.verdict) == "effects_found"
    (step,) = found.effects
    assert step.name == "lamp_step"
    size = step.parameters["step_rel"]
    assert size.value == pytest.approx(0.01, abs=3.5 * size.u)


@pytest.mark.slow
@pytest.mark.usefixtures("laws_left_out")
@pytest.mark.parametrize("known", [True, False])
def test_a_quiet_series_agrees(known):
    """Also without a statement of the camera: its black level is taken from the noise, and that is stated."""
    found = asked(header(120, known=known), series(lambda t: 900.0, 120, offset=lambda t: 0.0, seed=43))
    assert str(found.verdict) == "agrees"
    assert any("noise of the light extrapolates" in line for line in found.assumptions) is not known
