"""Charge that moves the borders of pixels: by hand, by draws, and next to what two CCDs were measured to do."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.signal import fftconvolve

from simulators.effects.brighter_fatter import BrighterFatter, push_of
from simulators.effects.catalogue import well_e
from simulators.effects.tile_moments import TileMoments
from testing.effect_context import effect_context

FAR = BrighterFatter(share=0.01, reach_px=8.0, height_x_px=0.6, height_y_px=0.4)


def border(x: float, y: float, height: float) -> float:
    """Return the integral of x/(x² + y² + h²)² over a border of one pixel, by quadrature."""
    return float(quad(lambda along: x / (x * x + along * along + height * height) ** 2, y - 0.5, y + 0.5)[0])


def test_borders_move_by_the_field_over_them() -> None:
    """Each border takes the field's integral over it; the four nearest get four times the share together."""
    push = push_of(3, 0.6, 0.4)
    nearest = 0.5 * (border(0.5, 0.0, 0.6) + border(0.5, 0.0, 0.4))
    for i, j in ((0, 0), (1, 0), (0, 1), (2, 2), (-1, 0), (-3, 1)):
        across = border(i + 0.5, j, 0.6) / nearest
        assert push.across[j + 2, i + 3] == pytest.approx(across, rel=1e-9)
        assert push.down[i + 3, j + 2] == pytest.approx(border(i + 0.5, j, 0.4) / nearest, rel=1e-9)
    assert push.kernel[3, 3] == pytest.approx(-4.0)
    neighbour = (border(0.5, 0, 0.6) - border(1.5, 0, 0.6) - 2 * border(0.5, 1, 0.4)) / nearest
    assert push.kernel[3, 4] == pytest.approx(neighbour, rel=1e-9)
    assert push.own[0] == pytest.approx(2.0 * -4.0, rel=1e-5)  # to first order in the share
    assert push.right[0] == pytest.approx(2.0 * neighbour, rel=1e-4)
    assert push.below[0] == pytest.approx(2.0 * push.kernel[4, 3], rel=1e-4)


def test_four_neighbours_share_where_only_the_nearest_borders_move() -> None:
    """By the plain form each neighbour of a lone full pixel gets b·z/2·S, no other gets anything, and none is lost."""
    well = well_e(effect_context())
    spot = np.zeros((9, 9))
    spot[4, 4] = well
    moved = BrighterFatter(share=1e-6).sample(spot, effect_context(), np.random.default_rng(0)) - spot
    expected = np.zeros((9, 9))
    expected[[3, 5, 4, 4], [4, 4, 3, 5]] = 0.5 * 1e-6 * well
    expected[4, 4] = -4 * 0.5 * 1e-6 * well
    np.testing.assert_allclose(moved, expected, atol=1e-11 * well)  # what is pushed again goes with the square


def test_no_charge_is_lost_however_far_it_pushes() -> None:
    """The sum over a picture stays to rounding, and so does an even field."""
    picture = np.random.default_rng(3).uniform(0.0, 9000.0, (40, 50))
    after = FAR.sample(picture, effect_context(), np.random.default_rng(0))
    assert after.sum() == pytest.approx(picture.sum(), rel=1e-12)
    assert np.abs(after - picture).max() > 1.0
    even = np.full((40, 50), 5000.0)
    np.testing.assert_allclose(FAR.sample(even, effect_context(), np.random.default_rng(0)), even, rtol=1e-12)


def test_noise_of_flats_has_the_moments_that_are_predicted() -> None:
    """Variance and covariances of neighbours of 40 flats, within 5 standard errors; beyond, what the kernel says."""
    context, size, level, frames, strong = effect_context(), 200, 6000.0, 40, replace(FAR, share=0.1)
    rng = np.random.default_rng(11)
    lags = {(0, 0): 0.0, (0, 1): 0.0, (1, 0): 0.0, (1, 1): 0.0, (0, 2): 0.0}
    for _ in range(frames):
        flat = strong.sample(level + math.sqrt(level) * rng.standard_normal((size, size)), context, rng) - level
        flat = flat[12:-12, 12:-12]
        for i, j in lags:
            lags[i, j] += float(np.mean(flat[i:, j:] * flat[: flat.shape[0] - i, : flat.shape[1] - j])) / frames
    u = level / math.sqrt(frames * (size - 24) ** 2)
    one = np.full((1, 1, 1), level)
    predicted = strong.moments(replace(TileMoments.exactly(one), variance=one), context)
    assert lags[0, 0] == pytest.approx(predicted.variance.item(), abs=5 * math.sqrt(2) * u)
    assert lags[0, 1] == pytest.approx(predicted.neighbour_x.item(), abs=5 * u)
    assert lags[1, 0] == pytest.approx(predicted.neighbour_y.item(), abs=5 * u)
    assert (
        predicted.neighbour_y.item() > predicted.neighbour_x.item() + 10 * u
    )  # what is nearer the charge is pushed more
    expected = level * _of_gathered_noise(strong, level)
    middle = expected.shape[0] // 2
    assert predicted.variance.item() == pytest.approx(expected[middle, middle], rel=1e-5)
    for (i, j), seen in lags.items():
        assert seen == pytest.approx(expected[middle + i, middle + j], abs=5 * math.sqrt(2) * u), (i, j)
    assert lags[1, 1] > 10 * u  # beyond the nearest


def _of_gathered_noise(effect: BrighterFatter, level: float, terms: int = 16) -> np.ndarray:
    """Return covariances over shot noise by lag: Σ (2aμ)ⁿ/(n+1)! of Astier et al. (2019), powers by convolution."""
    a = effect.slopes_per_e(well_e(effect_context())) * level
    total = np.zeros((97, 97))
    total[48, 48] = 1.0
    power = total.copy()
    for n in range(1, terms):
        power = fftconvolve(power, 2.0 * a, mode="same")
        total += power / math.factorial(n + 1)
    return total


def test_sums_over_farther_pixels_are_those_of_all_covariances() -> None:
    """Along a row, a column, and over all rows below; all lags together sum to the shot noise: no charge is lost."""
    level, strong = 6000.0, replace(FAR, share=0.08)
    one = np.full((1, 1, 1), level)
    predicted = strong.moments(replace(TileMoments.exactly(one), variance=one), effect_context())
    expected = level * _of_gathered_noise(strong, level)
    middle = expected.shape[0] // 2
    beyond_x, beyond_y = float(np.ravel(predicted.beyond_x)[0]), float(np.ravel(predicted.beyond_y)[0])
    assert beyond_x == pytest.approx(expected[middle, middle + 2 :].sum(), rel=1e-4)
    assert beyond_y == pytest.approx(expected[middle + 2 :, middle].sum(), rel=1e-4)
    below = expected[middle + 1 :].sum() - expected[middle + 1, middle]
    beyond_rows = float(np.ravel(predicted.beyond_rows)[0])
    assert beyond_rows == pytest.approx(below, rel=1e-3)
    sides = predicted.neighbour_x.item() + predicted.neighbour_y.item() + beyond_x + beyond_rows
    assert predicted.variance.item() + 2.0 * sides == pytest.approx(level, rel=1e-6)


def test_the_nearest_borders_alone_leave_little_beyond() -> None:
    """The plain form gives four neighbours all to first order: farther ones have what is pushed again."""
    level = 6000.0
    one = np.full((1, 1, 1), level)
    predicted = BrighterFatter(share=0.002).moments(replace(TileMoments.exactly(one), variance=one), effect_context())
    assert abs(float(np.ravel(predicted.beyond_x)[0])) < 0.01 * predicted.neighbour_x.item()
    assert abs(float(np.ravel(predicted.beyond_rows)[0])) < 0.02 * predicted.neighbour_x.item()


@pytest.mark.slow
def test_noise_gathers_while_borders_move() -> None:
    """Charge that comes in 150 steps, each moved by what has come, has the variance that is reported, to 5 sigma.

    A push of all charge at the end would leave 5 % less.
    """
    context, size, level, steps, flats, strong = effect_context(), 128, 5000.0, 150, 12, replace(FAR, share=0.06)
    a = strong.slopes_per_e(well_e(context))
    wide = np.zeros((size, size))
    wide[: a.shape[0], : a.shape[1]] = a
    waves = np.fft.rfft2(np.roll(wide, (-8, -8), (0, 1)))
    rng, step, variance, neighbour = np.random.default_rng(4), level / steps, 0.0, 0.0
    for _ in range(flats):
        come = np.zeros((size, size))
        for _ in range(steps):
            shot = math.sqrt(step) * rng.standard_normal((size, size))
            moved = np.fft.irfft2(np.fft.rfft2(come + 0.5 * shot) * waves, s=come.shape)
            come = come + shot + step * moved
        variance += float(np.mean(np.square(come))) / flats
        neighbour += float(np.mean(come[:, 1:] * come[:, :-1])) / flats
    one = np.full((1, 1, 1), level)
    predicted = strong.moments(replace(TileMoments.exactly(one), variance=one), context)
    u = level / size / math.sqrt(flats)
    assert variance == pytest.approx(predicted.variance.item(), abs=5 * math.sqrt(2) * u)
    assert neighbour == pytest.approx(predicted.neighbour_x.item(), abs=5 * u)
    kernel = 0.5 * level * a
    kernel[8, 8] += 1.0
    assert variance > level * np.sum(np.square(kernel)) + 8 * u


def test_a_step_between_patches_loses_what_its_last_line_does() -> None:
    """The share of a step that the last line inside a patch loses is the predicted one, by a picture of two halves."""
    well = well_e(effect_context())
    low, step = 0.5 * well, 1e-3 * well
    halves = np.where(np.arange(60) < 30, low + step, low)[None, :] * np.ones((60, 1))
    even = replace(FAR, share=1e-4, edge_fill=1.0, height_y_px=FAR.height_x_px)
    moved = even.sample(halves, effect_context(), np.random.default_rng(0)) - halves
    lost = -moved[30, 29] / step
    predicted = even.moments(TileMoments.exactly(np.full((1, 1, 1), low)), effect_context()).edge_share.item()
    assert lost == pytest.approx(predicted, rel=5e-3)
    assert lost > 1.2 * 1e-4 * 0.5  # more than the nearest border alone


def test_a_fit_may_take_the_far_form() -> None:
    """The plain form loosens to one with heights, once."""
    plain = BrighterFatter(0.005)
    (far,) = plain.loosened(effect_context())
    assert plain.free() == ("share", "edge_fill")
    assert far.free() == ("share", "edge_fill", "height_x_px", "height_y_px")
    assert far.share == 0.005
    assert far.loosened(effect_context()) == ()


@pytest.mark.parametrize("sensor", ["e2v", "itl"])
def test_two_ccds_are_followed_from_variance_and_neighbours(sensor: str, shared_data: Path) -> None:
    """Of what LSST's sensors show, variance and nearest neighbours tell share and heights; those predict lag 2.

    Measured slopes of covariance over mean, to lag 8 (C. Lage, Poisson_CCD). The sum over all lags is nothing, the
    ratio of the neighbours is the measured one, and both second neighbours together come within 20 % of what was
    measured, or its own standard error where that is more (27 % for the ITL sensor).
    """
    table = np.zeros((9, 9))
    spread = np.zeros((9, 9))
    path = shared_data / "sensors" / "lsst_brighter_fatter" / f"{sensor}_covariances_21oct19.txt"
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        if len(cells := line.split()) == 4:
            table[int(cells[0]), int(cells[1])], spread[int(cells[0]), int(cells[1])] = map(float, cells[2:])
    context, mean = effect_context(), np.array([2000.0, 4000.0]).reshape(-1, 1, 1)

    def slopes(p: np.ndarray) -> np.ndarray:
        effect = BrighterFatter(p[0] / 100, reach_px=8.0, height_x_px=p[1], height_y_px=p[2])
        after = effect.moments(replace(TileMoments.exactly(mean), variance=mean), context)
        excess = [(after.variance - mean) / mean**2, after.neighbour_x / mean**2, after.neighbour_y / mean**2]
        slope_at_0 = [2 * one.ravel()[0] - one.ravel()[1] for one in excess]  # terms of x² taken off
        return np.array(slope_at_0) / np.array([table[0, 0], table[0, 1], table[1, 0]]) - 1.0

    fit = least_squares(slopes, [0.3, 0.5, 0.5], diff_step=1e-4, bounds=([0, 0.05, 0.05], [9, 3, 3]))
    np.testing.assert_allclose(fit.fun, 0.0, atol=1e-3)
    share, height_x, height_y = fit.x
    found = BrighterFatter(share / 100, reach_px=8.0, height_x_px=height_x, height_y_px=height_y)
    kernel = found.slopes_per_e(well_e(context))
    assert kernel[8, 8] == pytest.approx(table[0, 0], rel=2e-3)
    assert kernel[8, 9] / kernel[9, 8] == pytest.approx(table[0, 1] / table[1, 0], rel=0.05)
    assert abs(kernel.sum()) < 0.01 * abs(kernel[8, 8])
    measured, u = table[0, 2] + table[2, 0], math.hypot(spread[0, 2], spread[2, 0])
    assert kernel[8, 10] + kernel[10, 8] == pytest.approx(measured, abs=max(0.2 * measured, u))
