"""The inner loops over pixels, compiled: one pass over a frame for all sums of its tiles, one for its coarse picture.

They hold no lock, so that other threads read the next frames meanwhile.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.compiled import compiled
from radiometer.typing import Array

Corners = NDArray[np.intp]


@compiled
def add_tiles(
    dn: NDArray[Any],
    good: NDArray[np.bool_],
    top: Corners,
    left: Corners,
    nearly_full: float,
    comb_mad_dn: float,
    total: Array,
    square: Array,
    pair_x: Array,
    pair_y: Array,
    histogram: Array,
    occurring: NDArray[np.bool_],
) -> tuple[Array, Array, Array, Array]:
    """Add one frame to the sums of all tiles of one size.

    Args:
        dn: The frame in DN, (rows, columns).
        good: Pixels that count for a tile's mean, same shape.
        top: (tiles,) first row of each tile.
        left: (tiles,) first column of each tile.
        nearly_full: Digital number from which a sample counts as clipped.
        comb_mad_dn: Median absolute deviation above which a tile's histogram must be smooth, in DN.
        total: (tiles, height, width) sum of deviations from the tile's mean in DN; this frame is added.
        square: Same shape, sum of their squares; this frame is added.
        pair_x: Same shape, sum of products with the left neighbour in DN²; this frame is added.
        pair_y: The same with the upper neighbour.
        histogram: Counts of digital numbers over smooth tiles, longer than the largest one; this frame is added.
        occurring: Digital numbers that occur in any tile, as long; this frame is added.

    Returns:
        (tiles,) mean in DN, share at 0, share clipped, and (tiles, height) sum of deviations along each row of the
        pixels that count.
    """
    tiles, height, width = total.shape
    mean, low, high = np.zeros(tiles), np.zeros(tiles), np.zeros(tiles)
    rows = np.zeros((tiles, height))
    counts = np.zeros(histogram.size, np.int64)
    for k in range(tiles):
        y0, x0 = top[k], left[k]
        light, number, dark, full = 0.0, 0, 0, 0
        smallest, largest = histogram.size, 0
        for i in range(height):
            for j in range(width):
                value = int(dn[y0 + i, x0 + j])
                counts[value] += 1
                smallest = min(smallest, value)
                largest = max(largest, value)
                dark += int(value <= 0)
                full += int(value >= nearly_full)
                if good[y0 + i, x0 + j]:
                    light += value
                    number += 1
        middle = light / number if number else np.nan
        mean[k], low[k], high[k] = middle, dark / (height * width), full / (height * width)
        for i in range(height):
            along = 0.0
            before = 0.0
            for j in range(width):
                deviation = dn[y0 + i, x0 + j] - middle
                total[k, i, j] += deviation
                square[k, i, j] += deviation * deviation
                along += deviation * good[y0 + i, x0 + j]
                pair_x[k, i, j] += deviation * before
                before = deviation
            rows[k, i] = along
        for i in range(1, height):
            for j in range(width):
                pair_y[k, i, j] += (dn[y0 + i, x0 + j] - middle) * (dn[y0 + i - 1, x0 + j] - middle)
        smooth = dark == 0 and full == 0 and _within(counts, middle, comb_mad_dn) * 2 < height * width
        for code in range(smallest, largest + 1):
            if smooth:
                histogram[code] += counts[code]
            occurring[code] |= counts[code] > 0
            counts[code] = 0
    return mean, low, high, rows


@compiled
def _within(counts: NDArray[np.int64], middle: float, distance: float) -> int:
    """Return how many samples are within a distance of the middle."""
    first = max(int(np.ceil(middle - distance)), 0)
    last = min(int(np.floor(middle + distance)), counts.size - 1)
    return int(counts[first : last + 1].sum())


@compiled
def coarse_cells(dn: NDArray[Any], cell: int, rows: int, columns: int) -> tuple[Array, Array]:
    """Return the mean of each cell of `cell` × `cell` pixels in DN, and its largest value.

    Args:
        dn: The frame in DN.
        cell: Edge of a cell in pixels.
    """
    mean, largest = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i in range(rows * cell):
        for j in range(columns * cell):
            value = int(dn[i, j])
            mean[i // cell, j // cell] += value
            if value > largest[i // cell, j // cell]:
                largest[i // cell, j // cell] = value
    return mean / (cell * cell), largest
