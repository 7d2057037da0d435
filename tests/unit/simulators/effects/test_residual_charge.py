"""Charge that traps let go: by figures worked out by hand, of single frames, of captures and of the camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.reconciliation.tile_model import CapturesPast, FrameTimes
from simulators.chain.virtual_sensor import FadingPast
from simulators.effects.residual_charge import ResidualCharge
from tests.unit.simulators.effects.test_laws_by_figures import at

TRAPS = ResidualCharge(share=0.01, tau_s=20.0)
TIMES = FrameTimes(np.array([0.0, 5.0, 30.0, 40.0]), np.array([0, 0, 1, 2]), np.array([0, 1, 0, 0]), 3)
HELD = np.array([[1000.0, 0.0], [10.0, 400.0], [7.0, 7.0]])


def test_what_three_frames_left_comes_free_by_their_age():
    """Each frame by its own age: two of 1000 e-, one of 10 e- later; within a series the second sees the first."""
    past = CapturesPast(TIMES, HELD)
    older = 1000.0 * (math.exp(-30.0 / 20.0) + math.exp(-25.0 / 20.0))
    last = 1000.0 * (math.exp(-2.0) + math.exp(-1.75)) + 10.0 * math.exp(-0.5)
    own = 1000.0 * math.exp(-0.25) / 2  # the second frame behind the first, on average over both
    assert past.faded(20.0)[:, 0, 0] == pytest.approx([own, older, last])
    assert past.faded(20.0)[:, 1, 0] == pytest.approx([0.0, 0.0, 400.0 * math.exp(-0.5)])


@pytest.mark.parametrize(("part", "own"), [("first", 0.0), ("later", 1000.0 * math.exp(-0.25)), ("all", 389.4003915)])
def test_the_first_of_a_series_sees_none_of_its_own(part, own):
    """Others see those before them; a lone frame is first and later."""
    found = CapturesPast(TIMES, HELD, part).faded(20.0)[:, 0, 0]
    assert found[0] == pytest.approx(own)
    assert found[1] == pytest.approx(CapturesPast(TIMES, HELD).faded(20.0)[1, 0, 0])


def test_an_exposure_takes_what_comes_free_in_it():
    """1 % of 5000 e- that are 10 s old, over 4 s with τ = 20 s; it scatters as so many electrons do."""
    context = replace(
        at(4.0), past=CapturesPast(FrameTimes(np.array([0.0, 10.0]), np.arange(2), np.zeros(2), 2), HELD[:2] * 5)
    )
    let_go = 0.01 * (1.0 - math.exp(-0.2)) * 5000.0 * math.exp(-0.5)
    signal = np.full((2, 2, 1), 300.0)
    assert TRAPS.mean(signal, context)[1, 0, 0] == pytest.approx(300.0 + let_go)
    assert np.asarray(TRAPS.variance(signal, context))[1, 0, 0] == pytest.approx(let_go)
    drawn = TRAPS.sample(np.full((2, 2, 40_000), 300.0), context, np.random.default_rng(1))[1, 0]
    assert drawn.mean() == pytest.approx(300.0 + let_go, abs=5 * math.sqrt(let_go / 40_000))
    assert drawn.var() == pytest.approx(let_go, rel=0.05)
    assert TRAPS.mean(signal, at(4.0)) == pytest.approx(signal)  # nothing is known of frames before


def test_the_camera_remembers_every_frame_once():
    """Three frames at 0, 10 and 25 s; another shape forgets, a frame without a time is none."""
    past = FadingPast()
    seen = []
    for now_s, charge in ((0.0, 100.0), (10.0, 50.0), (25.0, 1.0)):
        view = past.at(now_s, (1, 2))
        assert view is not None
        seen.append(float(view.faded(20.0)[0, 1]))
        past.add(np.full((1, 2), charge), now_s)
    first, second = 100.0 * math.exp(-0.5), 100.0 * math.exp(-1.25) + 50.0 * math.exp(-0.75)
    assert seen == pytest.approx([0.0, first, second])
    assert past.at(None, (1, 2)) is None
    past.add(np.full((1, 2), 9.0), None)
    assert past.at(25.0, (1, 2)).faded(20.0)[0, 0] == pytest.approx(second * 1.0 + 1.0)
    assert not past.at(25.0, (2, 2)).faded(20.0).any()


def test_starts_are_some_and_many_intervals_between_frames():
    """Half a second between frames: traps of 1, 7.5 and 50 s; times that are not known leave the usual ones."""
    since = np.array([np.inf, 0.5, 0.5, 9.0])
    assert [start.tau_s for start in ResidualCharge.starts(replace(at(1.0), since_frame_s=since))] == [1.0, 7.5, 50.0]
    assert [start.tau_s for start in ResidualCharge.starts(replace(at(1.0), since_frame_s=None))] == [
        30.0,
        225.0,
        1500.0,
    ]
    assert not ResidualCharge.usable(at(1.0))
