"""Rounding and missing codes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.data import CameraDescription, FrameSettings
from simulators.effects.base import Moments
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.missing_codes import MissingCodes
from simulators.effects.rounding import excess_kurtosis, rounded, rounded_normal, rounding_amplitude
from simulators.effects.tile_moments import TileMoments

_CONTEXT = ExposureContext(FrameSettings(1e-3), FrameGeometry.of_image(8, 6), CameraDescription(bit_depth=12))

PIXELS, FRAMES = 20_000, 100

# Mean, noise and fixed pattern in DN: on a code, between two, at the border, hardly any noise, mostly pattern, fine.
CASES = [(60.0, 0.23, 0.0), (60.3, 0.23, 0.0), (60.45, 0.06, 0.0), (60.4, 0.3, 0.2), (7.5, 0.1, 0.3), (9.2, 0.7, 0.4)]


def _moments(mean: float, noise: float, pattern: float) -> Moments:
    return Moments(*(np.array([value]) for value in (mean, noise**2, pattern**2, 1e-6)))


@pytest.mark.parametrize(("mean", "noise", "pattern"), CASES)
def test_moments_are_those_of_rounded_samples(mean: float, noise: float, pattern: float) -> None:
    """Mean, temporal and spatial variance of two million rounded samples lie within 4.5 of their standard errors."""
    rng = np.random.default_rng(5)
    pixels = mean + pattern * rng.standard_normal(PIXELS)
    codes = np.rint(pixels[:, None] + noise * rng.standard_normal((PIXELS, FRAMES)))
    after = rounded(_moments(mean, noise, pattern))
    of_pixel, within = codes.mean(axis=1), codes.var(axis=1, ddof=1)
    between = of_pixel.var(ddof=1) - within.mean() / FRAMES
    u_between = np.std((of_pixel - of_pixel.mean()) ** 2) / np.sqrt(PIXELS)
    assert abs(of_pixel.mean() - after.mean[0]) < 4.5 * of_pixel.std() / np.sqrt(PIXELS)
    assert abs(within.mean() - after.variance[0]) < 4.5 * within.std() / np.sqrt(PIXELS) + 1e-4 * within.mean()
    assert abs(between - after.spatial_variance[0]) < 4.5 * u_between + 1e-6


def test_fine_noise_leaves_the_mean_and_adds_a_twelfth() -> None:
    """With noise above half a code the mean stays and the variance grows by 1/12 DN²."""
    before = _moments(17.3, 1.0, 0.5)
    after = rounded(before)
    assert after.mean[0] == before.mean[0]
    assert after.variance[0] == pytest.approx(before.variance[0] + 1 / 12)
    assert float(rounding_amplitude(before)[0]) < 1e-10


def test_light_that_all_pixels_share_is_swallowed_by_a_code() -> None:
    """Far from the border between codes hardly any noise means that a common change does not show."""
    assert rounded(_moments(60.0, 0.06, 0.0)).common_variance[0] < 1e-12
    assert rounded(_moments(60.5, 0.06, 0.0)).common_variance[0] > 1e-6


@pytest.mark.parametrize(("phase", "noise"), [(0.0, 0.31), (0.5, 0.31), (0.2, 0.4), (0.0, 0.7)])
def test_excess_kurtosis_is_that_of_rounded_samples(phase: float, noise: float) -> None:
    """Noise of 0.31 DN at the middle of a code has 6, at its border −2; from 0.6 DN on nothing is asked."""
    codes = np.rint(17.0 + phase + noise * np.random.default_rng(3).standard_normal(1_000_000))
    apart = codes - codes.mean()
    predicted = 0.0 if noise > 0.6 else float(np.mean(apart**4) / np.mean(apart**2) ** 2 - 3.0)
    found = excess_kurtosis(_moments(17.0 + phase, noise, 0.0))
    assert np.asarray(found).ravel()[0] == pytest.approx(predicted, abs=0.1)


def _tiles(mean: float, noise: float, shared: float) -> TileMoments:
    """Return the moments of a tile whose neighbours in a row have a share of their noise in common."""
    before = TileMoments.exactly(np.full((1, 1, 1), mean))
    return replace(before, variance=np.full((1, 1, 1), noise**2), neighbour_x=np.full((1, 1, 1), shared * noise**2))


@cache
def _drawn() -> list[NDArray[np.float64]]:
    """Return two million triples of standard normal numbers."""
    return list(np.random.default_rng(11).standard_normal((3, 2_000_000)))


@pytest.mark.parametrize(
    ("mean", "noise", "step"),
    [
        (60.0, 0.23, 1),
        (60.3, 0.31, 1),
        (60.5, 0.06, 1),
        (31.2, 0.4, 4),
        (31.9, 2.1, 4),
        (64.0, 0.7, 128),
        (70.2, 4.1, 16),
    ],
)
def test_neighbours_share_what_the_codes_leave_of_it(mean: float, noise: float, step: int) -> None:
    """The covariance of neighbours behind rounding, and behind a coarse step, is that of two million rounded pairs."""
    share = 0.1
    common, *own = _drawn()
    pair = [mean + noise * (np.sqrt(share) * common + np.sqrt(1.0 - share) * one) for one in own]
    codes = [step * np.floor(np.rint(values) / step) for values in pair]
    products = (codes[0] - codes[0].mean()) * (codes[1] - codes[1].mean())
    after = rounded(_tiles(mean, noise, share))
    if step > 1:
        after = MissingCodes(step_codes=float(step)).moments(after, _CONTEXT)
    assert isinstance(after, TileMoments)
    found = float(np.ravel(after.neighbour_x)[0])
    second_order = share * max(float(products.mean()), 1e-6)  # what a pair's square has in common counts by the share²
    assert abs(found - products.mean()) < 4.5 * products.std() / np.sqrt(products.size) + second_order
    assert abs(found) <= float(np.ravel(after.variance)[0])


@pytest.mark.parametrize(("mean", "columns", "rows"), [(60.0, 0.2, 0.0), (60.5, 0.15, 0.0), (60.0, 0.0, 0.2)])
def test_what_lines_share_spreads_pixels_over_the_codes(mean: float, columns: float, rows: float) -> None:
    """Columns 0.2 DN apart, or rows that tremble so, change a pixel's noise as a pattern of its own does.

    2500 columns, or rows at 2500 times, tell it to 4.5 standard errors of their spread.
    """
    noise, lines, pixels = 0.33, 2500, 400
    rng = np.random.default_rng(8)
    at = mean + (columns + rows) * rng.standard_normal((lines, 1))
    codes = np.rint(at + noise * rng.standard_normal((lines, pixels)))
    within = codes.var(axis=1, ddof=1)
    one = TileMoments.exactly(np.full((1, 1, 1), mean))
    own, shaken, fixed = (np.full((1, 1, 1), s**2) for s in (noise, rows, columns))
    after = rounded(replace(one, variance=own, row_variance=shaken, fixed_column_variance=fixed))
    u_within = within.std() / np.sqrt(lines)
    assert float(after.variance[0, 0, 0]) == pytest.approx(within.mean(), abs=4.5 * u_within)
    assert abs(float(rounded(replace(one, variance=own)).variance[0, 0, 0]) - within.mean()) > 10.0 * u_within
    of_line = codes.mean(axis=1)
    u_mean = of_line.std() / np.sqrt(lines)
    assert float(after.mean[0, 0, 0]) == pytest.approx(of_line.mean(), abs=4.5 * u_mean)


def test_many_signals_are_rounded_as_each_by_itself() -> None:
    """Coarse ones next to fine ones in one array come out as they do alone, whatever stands next to them."""
    together = rounded(
        Moments(*(np.array(column) for column in zip(*((m, n**2, p**2, 1e-6) for m, n, p in CASES), strict=True)))
    )
    for number, case in enumerate(CASES):
        alone = rounded(_moments(*case))
        for field in ("mean", "variance", "spatial_variance", "common_variance"):
            values = np.broadcast_to(getattr(together, field), (len(CASES),))
            assert values[number] == pytest.approx(float(np.ravel(getattr(alone, field))[0]), rel=1e-9), (field, case)


def test_less_than_no_noise_is_none() -> None:
    """A variance below zero, which a step of a fit may try, is rounded as none: to the code nearest to the mean."""
    mean = np.array([60.3, 7.8, 60.3, 7.8])
    average, variance, _ = rounded_normal(mean, np.array([-4.0, -1e-9, 0.0, 0.0]))
    np.testing.assert_allclose(average, [60.0, 8.0, 60.0, 8.0])
    np.testing.assert_allclose(variance, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("period", "kept"), [(2, 1), (4, 1), (8, 1), (16, 1), (3, 2), (4, 2), (4, 3), (8, 7), (16, 15)]
)
def test_a_search_tries_the_codes_that_converters_leave_out(period: int, kept: int) -> None:
    """Bits that are stuck, one code of a period that never comes: some trial leaves exactly those codes."""
    codes, anywhere = np.arange(64.0), cast(Any, None)
    expected = set(codes[codes % period < kept])
    found = [set(np.ravel(MissingCodes(**trial).mean(codes, anywhere))) for trial in MissingCodes.trials]
    assert expected in found
