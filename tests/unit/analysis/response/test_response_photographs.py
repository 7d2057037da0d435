"""Responses from stacks that behave as photographs do: hand-held edges, a camera's tone curve, noise behind it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.analysis.response.auto import solve_auto
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.samples import gather_samples
from radiometer.data import Bracket, Frame, FrameSettings

Array = NDArray[np.float64]
PATCH_PX, ROWS, COLUMNS = 16, 10, 14


def scene() -> Array:
    """Return patches of ln radiance over seven e-foldings in random order, sloping a little within each."""
    rng = np.random.default_rng(11)
    tones = rng.permutation(np.linspace(-5.5, 1.5, ROWS * COLUMNS)).reshape(ROWS, COLUMNS)
    slope = np.linspace(-0.1, 0.1, PATCH_PX)
    return np.asarray(np.kron(tones, np.ones((PATCH_PX, PATCH_PX))) + np.tile(slope, COLUMNS)[None, :])


def tone_curve(light: Array) -> Array:
    """Return digital numbers of a tone curve with shoulder and a linear toe, before rounding."""
    share = 1.0 - np.exp(-light)
    return np.asarray(255.0 * np.where(share < 0.01, 12.33 * share, share**0.4545))


def true_log_exposure(dn: Array) -> Array:
    share = dn / 255.0
    return np.asarray(np.log(-np.log1p(-np.where(share < 0.1233, share / 12.33, share**2.2))))


def photographs(times: Sequence[float], shifts: Sequence[int], seed: int = 3) -> Bracket:
    """Return frames of the scene, each moved sideways by whole pixels, with noise behind the curve."""
    rng = np.random.default_rng(seed)
    frames = []
    for number, (seconds, shift) in enumerate(zip(times, shifts, strict=True)):
        light = np.exp(np.roll(scene(), shift, axis=1)) * seconds
        values = tone_curve(light) + 0.7 * rng.standard_normal(light.shape)
        dn = np.clip(np.round(values), 0, 255).astype(np.uint8)
        frames.append(Frame(dn, 8, FrameSettings(seconds), extra={"file": f"{number}.jpg"}))
    return Bracket.from_frames(frames, origin="photographs")


def rms_of(estimate: ResponseEstimate) -> float:
    dn = np.arange(13, 243)
    return float(np.std(estimate.curve.log_exposure[dn] - true_log_exposure(dn.astype(np.float64))))


TIMES = tuple(0.25 * 1.7**k for k in range(7))


@pytest.fixture(scope="module")
def moved() -> ResponseEstimate:
    return solve_auto(gather_samples(photographs(TIMES, (0, 1, -1, 2, 0, -2, 1))))


def test_edges_that_moved_do_not_bend_the_curve(moved: ResponseEstimate) -> None:
    """Frames shifted by a pixel or two give the curve of the even patches: within 1 % of the truth, and it is said."""
    assert rms_of(moved) < 0.01
    assert any("edges" in note for note in moved.notes)


def test_a_still_stack_keeps_all_its_pixels() -> None:
    """Where equally bright pixels vary no more at edges than elsewhere, all of them count."""
    still = gather_samples(photographs(TIMES, (0,) * 7))
    assert still.edge_scatter == 0.0
    moved = gather_samples(photographs(TIMES, (0, 1, -1, 2, 0, -2, 1)))
    assert moved.edge_scatter > 1.5
    assert moved.pixel_count < 0.6 * still.pixel_count
