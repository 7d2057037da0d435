"""Frames that lie apart by parts of a pixel: how far, as their own differences say."""

import numpy as np
import pytest

from radiometer.analysis.response.displacement import find_displacement
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve
from radiometer.photographs.response import displacement_of

# Frames a quarter of a stop apart, so that nearly all show every pixel about equally well.
POWER, TIMES = 1.0 / 2.2, 2.0 ** (np.arange(12) / 4.0)
SHAPE, DN_NOISE = (160, 200), 1.5


def _curve():
    g = np.log(np.maximum(np.arange(256), 0.5) / 128.0) / POWER
    return ResponseCurve(g, np.full(256, 1e-3), valid_dn=(5, 250))


def _scene(rng):
    """Return ln L of a smooth scene as a function of rows and columns: waves of 10 pixels and more."""
    waves = [
        (rng.normal(0.0, 0.15), *(rng.uniform(-0.6, 0.6, 2) / np.sqrt(2.0)), rng.uniform(0.0, 2.0 * np.pi))
        for _ in range(24)
    ]
    size, down, across, phase = np.array(waves).T

    def log_radiance(row, column):
        # The cosine of a sum of a row's part and a column's is the real part of a product of the two.
        of_rows = size * np.exp(1j * (down * row + phase))
        return (of_rows @ np.exp(1j * across[:, None] * column)).real

    return log_radiance


def _bracket(rng, shifts, *, scene=None):
    log_radiance = scene or _scene(rng)
    row, column = (axis.astype(float) for axis in np.ogrid[: SHAPE[0], : SHAPE[1]])
    frames = []
    for time, (down, across) in zip(TIMES, shifts, strict=True):
        light = np.exp(log_radiance(row + down, column + across)) * time / TIMES[-1]
        dn = 255.0 * np.minimum(0.2 * light, 1.2) ** POWER + DN_NOISE * rng.standard_normal(SHAPE)
        frames.append(Frame(np.clip(np.round(dn), 0, 255).astype(np.uint8), 8, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shift", [0.1, 0.3])
def test_known_shifts_come_back(shift, seed):
    """Frames in turn on the corners of a square of side 2δ: δ comes back within twice its u, a quarter at most.

    The noise next to it is that which was put in, to 15 %: shifts do not pass for noise.
    """
    corners = shift * np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)] * 3)
    found = find_displacement(_bracket(np.random.default_rng(seed), corners), _curve())
    assert abs(found.px - shift) < 2.0 * found.u_px
    assert found.u_px < 0.25 * shift
    level = np.array([0.0])  # ln H at the middle value, with g' there
    slope = np.array([1.0 / (128.0 * POWER)])
    noise = found.noise.variance(level, slope, np.ones(1))[0]
    assert noise == pytest.approx((DN_NOISE**2 + 1.0 / 12.0) * slope[0] ** 2, rel=0.15)


@pytest.mark.parametrize("seed", range(5))
def test_frames_in_one_place_are_not_displaced(seed):
    """Either no displacement is named and the noise is what it was, or one within three of its uncertainties of 0."""
    rng = np.random.default_rng(seed)
    bracket = _bracket(rng, np.zeros((TIMES.size, 2)))
    found = find_displacement(bracket, _curve())
    assert found.px < 0.05
    assert found.px <= 6.0 * found.u_px
    if found.px == 0.0:
        assert 0.0 < found.u_px < 0.1


def test_what_is_reported_not_to_have_shown_would_not_have_and_twice_that_does():
    """Where none shows u is the smallest δ that would have: half of it stays unseen, twice it is found, within 3 u."""
    still = find_displacement(_bracket(np.random.default_rng(0), np.zeros((TIMES.size, 2))), _curve())
    assert still.px == 0.0
    corners = still.u_px * np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)] * 3)
    less, more = (find_displacement(_bracket(np.random.default_rng(0), k * corners), _curve()) for k in (0.5, 2.0))
    assert less.px == 0.0
    assert abs(more.px - 2.0 * still.u_px) < 3.0 * more.u_px
    assert more.px > 0.0


def test_nothing_is_displaced_where_nothing_shows_it():
    """Without a gradient δ is 0; a curve of another depth is left to the merge."""
    rng = np.random.default_rng(3)
    found = find_displacement(
        _bracket(rng, rng.standard_normal((TIMES.size, 2)), scene=lambda row, column: 0.0 * (row + column)), _curve()
    )
    assert found.px == 0.0
    bracket = _bracket(np.random.default_rng(6), np.zeros((TIMES.size, 2)))
    assert displacement_of(bracket, ResponseCurve(np.arange(1024.0), np.zeros(1024))) is None
    known = displacement_of(bracket, _curve())
    assert known == find_displacement(bracket, _curve())
