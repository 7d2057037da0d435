"""Bands of a rolling shutter: their statistic, what they leave in tiles, and scatter that no trend explains."""

import dataclasses

import numpy as np
import pytest

from radiometer.reconciliation.descent import is_misfit
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.lines import RowBins, TileBands, wave_power
from radiometer.reconciliation.localise import localise, significant
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.verdict import place_of_scatter
from testing.reduced import start_of, statistics_of

PERIODS_PER_ROW = 0.0217
AMPLITUDE = 0.01


def _bands(seed, periods_per_row):
    """Return what a wave along the rows does to each frame's picture, at a phase of its own."""
    rng = np.random.default_rng(seed)

    def picture(image, setting):
        rows = np.arange(image.shape[0])[:, None]
        phase = rng.uniform(0, 2 * np.pi)
        return image * (1 + AMPLITUDE * np.sin(2 * np.pi * periods_per_row * rows + phase))

    return picture


def _one_after_the_other(captures):
    """Return exposures that differ a little, so that each has a capture of its own."""
    return [{"t": 3e-3 + 1e-5 * number} for number in range(captures)]


def test_without_bands_each_spatial_frequency_is_noise(make_capture):
    """The mean of some hundred ratios, two degrees of freedom each, is 1 within 4 sigma; darks have none."""
    captured = make_capture(plan=[*_one_after_the_other(24), {"t": 1e-3, "shutter": "closed"}], seed=4)
    seen = statistics_of(captured)
    lit = np.isfinite(seen.bands)
    assert lit.sum(axis=1).max() > 10
    assert np.mean(seen.bands[lit]) == pytest.approx(1.0, abs=4 * np.sqrt(1.0 / lit.sum()))


def test_a_tile_that_ends_where_a_bin_ends_covers_no_further_one(make_capture):
    """Rows 10 to 31 of 480, two to a bin, are 11 bins: three whole orders; the next row begins a twelfth."""
    captured = make_capture(plan=[{"t": 3e-3}], frames=1)
    small = Design.of(captured.header, captured.frames[0].shape)
    tiles = [dataclasses.replace(small.tiles[0], y=10, height=height) for height in (22, 23)]
    ending, reaching = (RowBins.of(dataclasses.replace(small, shape=(480, 96), tiles=(tile,))) for tile in tiles)
    assert (ending.step, ending.number, ending.orders) == (2, 240, 3)
    assert reaching.orders == 4
    np.testing.assert_array_equal(ending.middle[:3], [0.5, 2.5, 4.5])


def test_bands_have_the_power_that_a_wave_predicts(make_capture):
    """Over 24 captures the ratios summed over all frequencies agree with 1 + A²/2·|z|² within 4 sigma of the phases."""
    captured = make_capture(plan=_one_after_the_other(24), picture=_bands(5, PERIODS_PER_ROW), seed=5)
    design = Design.of(captured.header, captured.frames[0].shape)
    seen, _ = reduce_frames(design, captured.frames.__getitem__)
    power, common = wave_power(RowBins.of(design), seen.bands_basis, PERIODS_PER_ROW)
    measured = np.nansum(seen.bands, axis=1)
    expected = np.sum(np.where(np.isfinite(seen.bands), 1 + AMPLITUDE**2 / 2 * power, 0.0), axis=1)
    assert expected.min() > 10 * seen.bands.shape[1]
    ratio = measured / expected
    assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std(ddof=1) / np.sqrt(ratio.size))
    shared = seen.common * seen.common_unit / (AMPLITUDE**2 / 2 * common)
    assert shared.mean() == pytest.approx(1.0, abs=4 * shared.std(ddof=1) / np.sqrt(shared.size))


def test_a_tile_keeps_of_a_wave_what_random_phases_show(make_capture):
    """Mean, rise, spread and neighbours of a tile's rows over 20 000 phases, against the closed forms."""
    captured = make_capture(plan=[{"t": 3e-3}])
    design = Design.of(captured.header, captured.frames[0].shape)
    left = TileBands.of(design, PERIODS_PER_ROW)
    height = design.tiles[0].height
    phases = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)[:, None]
    y = np.arange(height) - (height - 1) / 2
    waves = np.sqrt(2.0) * np.cos(2 * np.pi * PERIODS_PER_ROW * y + phases)
    fitted = np.polynomial.polynomial.polyfit(y / (height / 2), waves.T, 1)
    quadratic = np.polynomial.polynomial.polyfit(y, waves.T, 2)
    rough = waves - np.polynomial.polynomial.polyval(y, quadratic)
    inside = waves - waves.mean(axis=1, keepdims=True)
    assert left.mean[0] ** 2 == pytest.approx(np.mean(waves.mean(axis=1) ** 2), rel=1e-6)
    assert left.rise[0] ** 2 == pytest.approx(np.mean(fitted[1] ** 2), rel=1e-6)
    assert left.within[0] == pytest.approx(np.mean(inside**2), rel=1e-6)
    assert left.rough[0] == pytest.approx(np.mean(rough**2), rel=1e-6)
    assert left.lag[0] == pytest.approx(np.mean(inside[:, 1:] * inside[:, :-1]), rel=1e-6)


@pytest.mark.slow
def test_bands_and_flicker_show_in_statistics_of_their_own(make_capture):
    """Bands lead in `bands`; a flicker that all rows share leaves nothing there."""
    plan = [{"t": t, "d": d} for t in (1e-3, 2e-3, 3e-3) for d in (0.5, 0.9) for _ in range(3)]
    banded = significant(localise(start_of(make_capture(plan=plan, picture=_bands(6, PERIODS_PER_ROW), seed=6))))
    assert banded[0].block == "bands"
    shaken = {test.block for test in significant(localise(start_of(make_capture(plan=plan, picture=_bands(7, 0.0)))))}
    assert "common" in shaken
    assert "bands" not in shaken


@pytest.mark.slow
def test_scatter_without_any_trend_is_reported(make_capture):
    """Patches that differ at random from frame to frame by 0.5 % scatter the means beyond their noise."""
    rng = np.random.default_rng(9)

    def uneasy(image, setting):
        height, width = image.shape
        patches = 1 + 0.005 * rng.standard_normal((4, 6))
        return image * np.kron(patches, np.ones((height // 4, width // 6)))

    plan = [{"t": t, "d": d} for t in (1e-3, 2e-3, 4e-3) for d in (0.3, 0.5, 0.9) for _ in range(3)]
    calm, restless = (start_of(make_capture(plan=plan, seed=8, **hidden)) for hidden in ({}, {"picture": uneasy}))
    assert not is_misfit(calm)
    assert is_misfit(restless)
    assert place_of_scatter(restless, localise(restless))[0] in ("mean", "first", "bands")
