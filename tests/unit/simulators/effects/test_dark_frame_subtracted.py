"""Frames less a dark frame, held against frames from which darks were drawn and subtracted by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings
from simulators.chain.camera_model import CameraModel
from simulators.effects.base import Moments
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.dark_frame_subtracted import DarkFrameSubtracted
from simulators.effects.tile_moments import TileMoments
from testing.effect_context import effect_context

ROWS, COLUMNS, FRAMES = 150, 200, 16
READ_E, E_PER_DN, BLACK_DN = 2.4, 2.6, 64.0


def _setting(exposure_s: float = 0.1, gain_db: float = 0.0, dark_e: float = 20.0) -> ExposureContext:
    """Return a camera whose pixels gather so many dark electrons in 0.1 s."""
    base = effect_context()
    camera = base.camera.model_copy(update={"dark_current_e_per_s": dark_e / 0.1})
    settings = FrameSettings(exposure_s, gain_db, 5.6, BLACK_DN, 25.0, 60.0, 0.8)
    return replace(base, camera=camera, settings=settings, geometry=FrameGeometry.of_image(COLUMNS, ROWS), code=None)


def _by_hand(
    light_e: float, dark_e: float, gain: float, count: int, pedestal: float, top: float = 4095.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and temporal variance of each pixel of frames less the whole codes of a mean of darks."""
    dice, shape = np.random.default_rng(7), (ROWS, COLUMNS)

    def frame(electrons: float) -> np.ndarray:
        held = dice.poisson(electrons, shape) + READ_E * dice.standard_normal(shape)
        return np.clip(np.rint(held * gain / E_PER_DN + BLACK_DN), 0.0, top)

    dark = np.rint(np.mean([frame(dark_e) for _ in range(count)], axis=0))
    left = np.array([np.maximum(frame(light_e + dark_e) - dark + pedestal, 0.0) for _ in range(FRAMES)])
    return left.mean(axis=0), left.var(axis=0, ddof=1)


def _reported(light_e: float, context: ExposureContext, effect: DarkFrameSubtracted) -> Moments:
    """Return the moments of the same: charge, its noise and that of reading, rounded, and the effect."""
    gain = 10.0 ** ((context.settings.gain_db or 0.0) / 20.0) / E_PER_DN
    dark_e = (context.camera.dark_current_e_per_s or 0.0) * context.settings.exposure_s
    one = np.ones((1, 1, 1))
    held = (light_e + dark_e) * gain + BLACK_DN
    variance = gain**2 * (light_e + dark_e + READ_E**2) + 1.0 / 12.0
    return effect.moments(replace(TileMoments.exactly(held * one), variance=variance * one), context)


@pytest.mark.parametrize("count", [1, 9])
@pytest.mark.parametrize(("pedestal", "dark_e"), [(0.0, 0.4), (32.0, 20.0)])
@pytest.mark.parametrize(("light_e", "gain_db"), [(0.0, 0.0), (4.0, 0.0), (500.0, 0.0), (4.0, 12.0)])
def test_moments_are_those_of_frames_less_a_drawn_dark(count, pedestal, dark_e, light_e, gain_db):
    """Mean, noise and pattern within five sigmas of the draws and two percent of their size.

    What is cut holds to a tenth and 0.05 DN: counts of few electrons and codes of one sigma are not normal. Tiles
    within four sigmas of zero are not compared.
    """
    context, effect = _setting(gain_db=gain_db, dark_e=dark_e), DarkFrameSubtracted(1.0 / count, pedestal)
    seen, noise = _by_hand(light_e, dark_e, 10.0 ** (gain_db / 20.0), count, pedestal)
    reported = _reported(light_e, context, effect)
    mean, variance, fixed = (
        float(np.ravel(v)[0]) for v in (reported.mean, reported.variance, reported.spatial_variance)
    )
    pattern = np.square(seen - seen.mean()) - noise / FRAMES
    root = np.sqrt(seen.size)
    cut = pedestal == 0.0 and light_e < 100.0
    assert mean == pytest.approx(seen.mean(), abs=5 * seen.std() / root + 0.05 * cut)
    assert variance == pytest.approx(noise.mean(), abs=5 * noise.std() / root + 0.02 * cut, rel=0.1 if cut else 0.02)
    assert fixed == pytest.approx(pattern.mean(), abs=5 * pattern.std() / root + 0.02 * cut, rel=0.1 if cut else 0.02)
    assert isinstance(reported, TileMoments)
    assert float(np.ravel(reported.renewed_variance)[0]) == pytest.approx(fixed)
    assert not np.any(reported.limit_variance)


def test_the_highest_code_comes_down_and_shows_the_dark_s_noise():
    """Where the converter is full all pixels show its highest code less their own dark."""
    context, effect = _setting(), DarkFrameSubtracted(1.0, 10.0)
    seen, noise = _by_hand(15_000.0, 20.0, 1.0, 1, 10.0)
    reported = _reported(15_000.0, context, effect)
    assert noise.max() == 0.0
    assert float(np.ravel(reported.variance)[0]) == pytest.approx(0.0, abs=1e-6)
    assert float(np.ravel(reported.mean)[0]) == pytest.approx(seen.mean(), abs=5 * seen.std() / np.sqrt(seen.size))
    assert float(np.ravel(reported.spatial_variance)[0]) == pytest.approx(seen.var(), rel=0.05)


def test_frames_of_one_setting_share_their_dark():
    """Two frames of one exposure differ by noise alone; the pattern of another exposure is another one."""
    effect = DarkFrameSubtracted(1.0, 32.0)
    dice = np.random.default_rng(1)
    signal = np.full((ROWS, COLUMNS), 200.0)
    first, again = (effect.sample(signal, _setting(), dice) for _ in range(2))
    other = effect.sample(signal, _setting(0.11), dice)
    np.testing.assert_array_equal(first, again)
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 5.0 / np.sqrt(signal.size)


def test_a_model_s_frames_are_those_of_its_moments():
    """A chain with the effect, drawn: mean, noise and pattern of its frames without light."""
    context, effect = _setting(), DarkFrameSubtracted(0.2, 32.0)
    model = CameraModel.ideal(context.camera, context.lens).with_effect(effect)
    scene = np.zeros((ROWS, COLUMNS))
    frames = np.array([model.sample(scene, context, (n,)).dn for n in range(FRAMES)], dtype=np.float64)
    predicted = model.moments(scene, context)
    seen, noise = frames.mean(axis=0), frames.var(axis=0, ddof=1)
    assert seen.mean() == pytest.approx(float(np.mean(predicted.mean)), abs=5 * seen.std() / np.sqrt(seen.size))
    assert noise.mean() == pytest.approx(float(np.mean(predicted.variance)), rel=0.03)
    assert seen.var() - noise.mean() / FRAMES == pytest.approx(float(np.mean(predicted.spatial_variance)), rel=0.05)


@pytest.mark.parametrize("lacking", ["conversion_gain_e_per_dn", "read_noise_e", "black_level_dn"])
def test_what_a_dark_holds_must_be_stated(lacking):
    """Without gain, read noise or black level no one says what a dark frame holds."""
    context = _setting()
    assert DarkFrameSubtracted.usable(context)
    if lacking == "black_level_dn":
        settings: Any = replace(context.settings, black_level_dn=None)
        assert not DarkFrameSubtracted.usable(replace(context, settings=settings))
    else:
        camera = CameraDescription(**context.camera.model_dump() | {lacking: None})
        assert not DarkFrameSubtracted.usable(replace(context, camera=camera))


def test_a_search_starts_from_nothing_half_and_all_of_the_black_level():
    """With the noise of one dark and that of ten."""
    starts = {(start.pedestal_dn, start.share) for start in DarkFrameSubtracted.starts(_setting())}
    assert starts == {(kept, share) for kept in (0.0, 32.0, 64.0) for share in (1.0, 0.1)}
