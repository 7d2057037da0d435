"""The pass over a frame's tiles against sums by numpy, compiled and as it is written."""

import numpy as np
import pytest

from radiometer.reconciliation.measure.reduce import add_tiles, coarse_cells

TOP, LEFT, HEIGHT, WIDTH = np.array([0, 2]), np.array([1, 5]), 4, 3
FULL = 40.0


def _written(function):
    """Return a compiled function as its source says it."""
    return getattr(function, "py_func", function)


def _sums():
    tiles = {name: np.zeros((2, HEIGHT, WIDTH)) for name in ("total", "square", "highest", "pair_x", "pair_y")}
    return {**tiles, "histogram": np.zeros(64), "occurring": np.zeros(64, np.bool_)}


@pytest.fixture
def frame():
    """Return a frame whose first tile holds a 0 and a clipped value, the second neither."""
    dn = np.random.default_rng(4).integers(10, 30, (7, 9)).astype(np.uint16)
    dn[1, 2], dn[3, 1] = 0, 41
    return dn


BOTH = pytest.mark.parametrize("form", [lambda function: function, _written], ids=["compiled", "as written"])


@BOTH
def test_sums_of_tiles_are_those_of_their_pixels(frame, form):
    """Mean over good pixels, shares at 0 and clipped, deviations, squares, products with neighbours, row sums."""
    good = np.ones(frame.shape, np.bool_)
    good[3, 5] = False
    sums = _sums()
    mean, low, high, rows = form(add_tiles)(frame, good, TOP, LEFT, FULL, 100.0, *sums.values())
    assert low.tolist() == pytest.approx([1 / 12, 0.0])
    assert high.tolist() == pytest.approx([1 / 12, 0.0])
    for k, (y, x) in enumerate(zip(TOP, LEFT, strict=True)):
        place = np.s_[y : y + HEIGHT, x : x + WIDTH]
        tile, counts = frame[place].astype(float), good[place]
        assert mean[k] == pytest.approx(tile[counts].mean())
        deviation = tile - tile[counts].mean()
        assert sums["total"][k] == pytest.approx(deviation)
        assert sums["square"][k] == pytest.approx(deviation**2)
        assert sums["highest"][k] == pytest.approx(np.maximum(deviation, 0.0))
        assert sums["pair_x"][k][:, 1:] == pytest.approx(deviation[:, 1:] * deviation[:, :-1])
        assert sums["pair_x"][k][:, 0].tolist() == [0.0] * HEIGHT
        assert sums["pair_y"][k][1:] == pytest.approx(deviation[1:] * deviation[:-1])
        assert sums["pair_y"][k][0].tolist() == [0.0] * WIDTH
        assert rows[k] == pytest.approx((deviation * counts).sum(axis=1))


@BOTH
def test_a_second_frame_is_added(frame, form):
    """Sums of the same frame twice are twice those of once."""
    once, twice, good = _sums(), _sums(), np.ones(frame.shape, np.bool_)
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *once.values())
    for _ in range(2):
        form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *twice.values())
    for name in ("total", "square", "pair_x", "pair_y", "histogram"):
        assert twice[name] == pytest.approx(2 * once[name])


@BOTH
def test_numbers_are_counted_where_a_tile_is_whole_and_wide(frame, form):
    """Every number occurs; only the tile without clipped pixels, wider than the comb's limit, enters the histogram."""
    good = np.ones(frame.shape, np.bool_)
    wide, narrow = _sums(), _sums()
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *wide.values())
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 100.0, *narrow.values())
    both = [frame[y : y + HEIGHT, x : x + WIDTH] for y, x in zip(TOP, LEFT, strict=True)]
    assert np.flatnonzero(wide["occurring"]).tolist() == sorted({int(value) for tile in both for value in tile.flat})
    assert wide["histogram"].tolist() == np.bincount(both[1].ravel(), minlength=64).tolist()
    assert narrow["histogram"].sum() == 0


@BOTH
def test_a_tile_without_a_good_pixel_has_no_mean(frame, form):
    """No number stands where none was measured."""
    sums = _sums()
    mean, *_ = form(add_tiles)(frame, np.zeros(frame.shape, np.bool_), TOP, LEFT, FULL, 0.0, *sums.values())
    assert np.isnan(mean).all()


@BOTH
def test_cells_hold_mean_and_largest_value(frame, form):
    """Two by two pixels each; what is beyond the last whole cell is left out."""
    mean, largest = form(coarse_cells)(frame, 2, 3, 4)
    cells = frame[:6, :8].reshape(3, 2, 4, 2)
    assert mean == pytest.approx(cells.mean(axis=(1, 3)))
    assert largest == pytest.approx(cells.max(axis=(1, 3)))
