"""Which entries count and how far they scatter, by masks and figures worked out by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.reconciliation.measure.edges import _steps_of
from radiometer.reconciliation.model.tile_context import PictureSurroundings
from radiometer.reconciliation.statistics import COMB_PERIODS, Counted, Scatter

NAN = math.nan


def some(**fields: Any) -> Any:
    return SimpleNamespace(**fields)


def asked(kind: Any, name: str, **fields: Any) -> Any:
    """Return what a property says of an object of which only some fields are known."""
    entry = vars(kind)[name]
    return (entry.func if hasattr(entry, "func") else entry.fget)(some(**fields))


def test_borders_count_where_they_were_measured_and_light_stands_out() -> None:
    """Of four captures one has no known border, one no tile that counts, and one light of a tenth of its noise."""
    found = asked(
        Counted,
        "bordered",
        seen=some(edge_u=np.array([0.1, NAN, 0.1, 0.1])),
        inside=np.array([[True, False], [True, True], [False, False], [True, True]]),
        base=some(
            signal=np.array([[900.0, 10.0], [900.0, 10.0], [900.0, 10.0], [1.0, 0.5]]),
            gain=np.ones(4),
            variance=np.full((4, 2), 100.0),
        ),
    )
    assert found.tolist() == [True, False, False, False]


def test_gain_lifts_light_above_its_noise() -> None:
    """20 electrons stand out by twice 10 DN at unit gain and by four times at twice that."""
    base = some(signal=np.full((2, 1), 20.0), gain=np.array([1.0, 2.0]), variance=np.full((2, 1), 100.0))
    seen, inside = some(edge_u=np.full(2, 0.1)), np.ones((2, 1), bool)
    assert asked(Counted, "bordered", seen=seen, inside=inside, base=base).tolist() == [False, True]


def test_waves_are_told_by_even_pictures_off_the_knee() -> None:
    """A scene, a capture of one frame and one with a tile at the knee of its well say nothing; nor does what is NaN."""
    found = asked(
        Counted,
        "banded",
        design=some(uniform=np.array([True, False, True, True])),
        whole=np.array([True, True, False, True]),
        knee=np.array([[False, False], [False, False], [False, False], [True, False]]),
        seen=some(bands=np.array([[1.0, NAN], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])),
    )
    assert found.tolist() == [[True, False], [False, False], [False, False], [False, False]]


@pytest.mark.parametrize("step", [1, 4])
def test_histograms_count_by_their_number_and_the_spacing_of_their_codes(step: int) -> None:
    """500 samples are too few, the capture with the highest code of all is left out; a spacing of 4 asks 2 and 4."""
    found = asked(
        Counted,
        "combed",
        step=step,
        seen=some(
            peak=np.array([[900.0, 40.0], [4095.0, 3.0], [900.0, NAN]]), comb_count=np.array([501.0, 9e3, 500.0])
        ),
        design=some(setting_id=np.arange(3)),
    )
    dividing = [step == 1 or period in (2, 4) for period in COMB_PERIODS]
    assert found.tolist() == [dividing, [False] * len(COMB_PERIODS), [False] * len(COMB_PERIODS)]


def test_histograms_of_the_first_four_captures_of_a_setting_count() -> None:
    """Six of one setting and two of another: which tiles are hardly wide enough is alike in all of one."""
    seen = some(peak=np.array([[4000.0], *[[900.0]] * 7]), comb_count=np.full(8, 9e3))
    setting = np.array([2, 0, 0, 1, 0, 0, 0, 1])
    found = asked(Counted, "combed", step=1, seen=seen, design=some(setting_id=setting))
    assert found.all(axis=1).tolist() == [False, True, True, True, True, True, False, True]


def test_a_combs_terms_scatter_as_those_of_honest_codes() -> None:
    """The mean of cos(2πn/period) over 300 codes that occur alike scatters by what is told, to 7 %."""
    told = asked(Scatter, "comb", base=some(), seen=some(comb_count=np.array([300.0])), design=some(uniform=True))[0]
    codes = np.random.default_rng(3).integers(0, 5040, (1500, 300))
    for period, sigma in zip(COMB_PERIODS, told, strict=True):
        drawn = np.cos(2.0 * np.pi * codes / period).mean(axis=1)
        assert drawn.std() == pytest.approx(sigma, rel=0.07)


@pytest.mark.parametrize(("declared", "least"), [(2.0, 4.0), (None, 1.0)])
def test_in_a_scene_the_least_noise_may_show_as_a_comb(declared: float | None, least: float) -> None:
    """Where no read noise is declared, the darkest as it was seen counts too; noise grows with the gain squared."""
    found = asked(
        Scatter,
        "comb",
        base=some(variance=np.array([[4.0, 9.0], [16.0, 36.0]]), gain=np.array([1.0, 2.0])),
        seen=some(variance=np.array([[1.0, 9.0], [NAN, 36.0]]), comb_count=np.full(2, 1e5)),
        design=some(uniform=False, header=some(camera=some(read_noise_e=declared))),
    )
    for capture, gain in enumerate((1.0, 2.0)):
        for number, period in enumerate(COMB_PERIODS):
            chance = (1.0 if period == 2 else 0.5) / 1e5
            left = math.exp(-2.0 * math.pi**2 * least * gain**2 / period**2)
            assert found[capture, number] == pytest.approx(math.sqrt(chance + left**2), rel=1e-9)


def test_few_outliers_scatter_as_counts_and_thousands_by_a_tenth() -> None:
    """2·√n scatters by 1; beyond a thousand a tenth of the root counts besides."""
    found = asked(Scatter, "outliers", seen=some(outliers=np.array([4.0, 1000.0, 4000.0])))
    assert found == pytest.approx([1.0, 1.0, math.hypot(1.0, 0.2 * (math.sqrt(4000.0) - math.sqrt(1000.0)))])


@pytest.mark.parametrize(("principal", "row", "column"), [(None, 5, 7), ((11.5, 7.5), 3, 5)])
def test_a_ghost_lies_across_the_axis(principal: tuple[float, float] | None, row: int, column: int) -> None:
    """Cells of 4 pixels turned about the frame's middle, or about the stated axis; beyond the picture there is none."""
    picture = np.arange(48.0).reshape(6, 8) + 1.0
    surroundings: Any = some(
        _design=some(header=some(lens=some(principal_point_px=principal)), shape=(24, 32)), _images=some(cell_px=4)
    )
    turned = PictureSurroundings._turned(surroundings, picture)
    for r in range(6):
        for c in range(8):
            there = 0 <= row - r < 6 and 0 <= column - c < 8
            assert turned[r, c] == pytest.approx(picture[row - r, column - c] if there else 0.0), (r, c)


def test_a_column_of_the_picture_has_its_mean_at_each_tile() -> None:
    """Columns whose means rise evenly: each point has that of where it lies, in units of its own tiles' light."""
    rows, columns = np.arange(6.0)[:, None], np.arange(8.0)
    picture = 20.0 + 5.0 * columns + (rows - 2.5)  # what goes down a column cancels in its mean
    tile = [some(x=8, y=4, width=8, height=8), some(x=20, y=12, width=4, height=4)]
    design: Any = some(patterns=("a",), pattern_index=np.array([0, 0]), tiles=tile, shape=(24, 32))
    images: Any = some(cell_px=4, picture=lambda pattern: picture)
    surroundings = PictureSurroundings(design, images)
    sampled = 20.0 + 5.0 * np.array([11.5, 21.5]) / 4.0 - 5.0 * 0.375 + (np.array([7.5, 13.5]) / 4.0 - 0.375 - 2.5)
    light = 3.0 * sampled[None, :, None] * np.ones((2, 2, 4)) * np.array([1.0, 0.5])[:, None, None]
    found = np.asarray(surroundings.column_mean(light))
    at_x = np.array([[11.5], [21.5]]) + np.array([[4.0], [2.0]]) * np.array([-1, 1, -1, 1]) / math.sqrt(3.0)
    wanted = 3.0 * (20.0 + 5.0 * (at_x / 4.0 - 0.375))
    assert found[0] == pytest.approx(wanted, rel=1e-6)
    assert found[1] == pytest.approx(0.5 * wanted, rel=1e-6)


def test_clipped_captures_and_those_without_noise_tell_no_edge() -> None:
    """A step of five sigmas between lines 2 and 3 in the one clear capture is found, whatever the others hold."""
    step = np.zeros((3, 1, 6))
    step[0, 0, 2] = 50.0
    step[1, 0, 4], step[2, 0, 1] = 1e6, 1e6
    line, clear = _steps_of(step, np.array([[False], [True], [False]]), np.array([[1.0], [1.0], [0.0]]))
    alone, sure = _steps_of(step[:1], np.array([[False]]), np.array([[1.0]]))
    assert (line.tolist(), clear.tolist()) == (alone.tolist(), sure.tolist())
