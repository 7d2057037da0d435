"""Image lag by a power of what was held (traps of many depths), and with less noise than light has."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings
from radiometer.reconciliation.tile_model import TileContext
from simulators.effects.context import FrameGeometry
from simulators.effects.image_lag import ImageLag
from simulators.effects.tile_moments import TileMoments


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
