"""What comes back every so many frames, and what is left without a name as one entry with its size."""

from itertools import count

import numpy as np
import pytest

from radiometer.data import Frame, FrameEntry, FrameSettings
from radiometer.reconciliation.engine import examine
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.frame_order import FrameLight, periodic
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
