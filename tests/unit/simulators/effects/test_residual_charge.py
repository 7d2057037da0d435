"""Charge that traps let go: by figures worked out by hand, of single frames, of captures and of the camera."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings
from radiometer.reconciliation.tile_model import CapturesPast, FrameTimes, TileContext
from simulators.chain.virtual_sensor import FadingPast
from simulators.effects.context import FrameGeometry
from simulators.effects.image_lag import ImageLag
from simulators.effects.residual_charge import ResidualCharge
from simulators.effects.tile_moments import TileMoments
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


def context_of(held_e: Any, full_well_e: float = 10_000.0, **more: Any) -> TileContext:
    """Return the circumstances of frames before which the pixels held so many electrons."""
    camera = CameraDescription(bit_depth=12, full_well_e=full_well_e)
    settings, geometry = FrameSettings(0.01), FrameGeometry.of_image(np.shape(held_e)[-1], np.shape(held_e)[-2])
    return TileContext(settings, geometry, camera, previous_e=np.asarray(held_e), **({"frames": None} | more))


def _left(lag: ImageLag, previous: float) -> float:
    return float(lag.mean(np.zeros((1, 1)), context_of([[previous]]))[0, 0])


@pytest.mark.parametrize(("power", "expected"), [(1.0, 80.0), (0.5, 40.0), (2.0, 320.0)])
def test_lag_by_a_power_goes_through_its_share_at_a_thousand_electrons(power: float, expected: float) -> None:
    """2 % of 1000 e- is 20 e- for every power; of 4000 e- it is 80 e- by a line, 40 by a root, 320 by a square."""
    lag = ImageLag(share=0.02, power=power)
    assert _left(lag, 1000.0) == pytest.approx(20.0)
    assert _left(lag, 4000.0) == pytest.approx(expected)
    assert _left(lag, 40000.0) == pytest.approx(20.0 * 10.0**power)  # no pixel holds more than its full well


def test_the_power_is_fitted_where_it_is_not_one() -> None:
    """The plain share alone is fitted of a line; a form of another power comes among its forms."""
    assert ImageLag(share=0.02).free() == ("share",)
    assert ImageLag(share=0.02, power=0.6).free() == ("share", "power")
    context = context_of([[0.0]])
    assert any(form.power != 1.0 for form in ImageLag.covers(context))
    assert any(form.power != 1.0 for form in ImageLag(share=0.02).loosened(context))
    assert [form.free() for form in ImageLag(share=0.02, power=0.6).loosened(context)] == [("share", "power", "noise")]
    assert ImageLag(share=0.02, power=0.6, noise=0.5).loosened(context) == ()


@pytest.mark.parametrize("noise", [0.0, 0.25, 1.0])
def test_what_stays_behind_scatters_by_its_share_of_the_noise_of_light(noise: float) -> None:
    """Of 4000 e- 2 % stay: 80 e- with a variance of 0, 20 or 80 e-², drawn in 200,000 pixels and predicted."""
    held = np.full((400, 500), 4000.0)
    context = context_of(held)
    lag, nothing = ImageLag(share=0.02, noise=noise), np.zeros(held.shape)
    drawn = lag.sample(nothing, context, np.random.default_rng(8))
    assert drawn.mean() == pytest.approx(80.0, abs=5.0 * np.sqrt(80.0 / held.size))
    assert drawn.var() == pytest.approx(80.0 * noise, rel=5.0 * np.sqrt(2.0 / held.size))
    assert np.allclose(lag.variance(nothing, context), 80.0 * noise)


def test_nothing_is_left_by_a_dark_frame() -> None:
    """A frame that held nothing leaves neither charge nor noise; a share below zero takes charge and adds no noise."""
    context = context_of([[0.0, 500.0]])
    signal = np.full((1, 2), 100.0)
    assert ImageLag(share=0.02).variance(signal, context).tolist() == [[0.0, 10.0]]
    assert ImageLag(share=-0.02).variance(signal, context).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("frames", [1, 2, 4, 6])
@pytest.mark.parametrize(("share", "older"), [(0.1, 0.0), (0.06, 0.05), (-0.08, 0.0)])
def test_noise_that_comes_back_makes_frames_alike(frames: int, share: float, older: float) -> None:
    """Scatter about the mean of a series, and of that mean from pixel to pixel, as drawn frame by frame."""
    rng, pixels = np.random.default_rng(frames), 400_000
    held = 5000.0 + np.sqrt(5000.0) * rng.standard_normal((frames + 2, pixels))
    seen = held[2:] + share * held[1:-1] + older * held[:-2]
    context = context_of([[[5000.0]]], full_well_e=20_000.0, frames=float(frames))
    before = replace(TileMoments.exactly(np.array([[[5000.0]]])), variance=np.array([[[5000.0]]]))
    lag = ImageLag(share=share, older_share=older, noise=0.0)
    predicted = lag.moments(before, context)
    counted = seen[1:] if frames > 2 else seen
    if frames > 1:
        scatter = float(np.mean(np.var(counted, axis=0, ddof=1)))
        own = 3.0 * scatter * np.sqrt(2.0 / (pixels * (len(counted) - 1))) + (share**2 + older**2) * 5000.0
        assert float(predicted.variance.item()) == pytest.approx(scatter, abs=1.2 * own)
    mean = float(np.var(np.mean(seen, axis=0)))
    own = 3.0 * mean * np.sqrt(2.0 / pixels) + 2.5 * (abs(share) + abs(older)) ** 2 * 5000.0 / frames
    expected = float(predicted.variance.item()) / frames + float(predicted.spatial_variance.item())
    assert expected == pytest.approx(mean, abs=own)
    if frames > 1:
        assert abs(mean - 5000.0 / frames) > own  # what a model without memory says
