"""Defective pixels of a map: marked, filled in from sound neighbours, and as uncertain as these differ."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import repair_defects
from radiometer.data import PixelMask


def images(size=5):
    """Return a picture that rises by one a pixel, u 0.1 everywhere, and an empty mask."""
    radiance = np.arange(float(size * size), dtype=np.float32).reshape(size, size)
    return radiance, np.full((size, size), 0.1, np.float32), np.zeros((size, size), np.uint8)


@pytest.mark.parametrize(("x", "y", "count"), [(2, 2, 8), (0, 0, 3), (4, 2, 5)])
def test_a_defect_takes_the_mean_of_its_sound_neighbours(x, y, count):
    """Eight, five at the side, three in the corner; u is the mean's noise and the neighbours' scatter in squares."""
    radiance, u, mask = images()
    window = [
        float(radiance[j, i])
        for j in range(max(y - 1, 0), min(y + 2, 5))
        for i in range(max(x - 1, 0), min(x + 2, 5))
        if (i, j) != (x, y)
    ]
    radiance[y, x], u[y, x] = 1e6, 1e3
    repair_defects(radiance, u, mask, [(x, y)])
    assert len(window) == count
    assert radiance[y, x] == pytest.approx(np.mean(window))
    assert u[y, x] == pytest.approx(math.sqrt(0.01 / count + np.var(window, ddof=1)))
    assert mask[y, x] == PixelMask.DEFECTIVE
    assert np.count_nonzero(mask) == 1


def test_neighbours_that_are_defective_or_clipped_tell_nothing():
    """Only sound ones count; marked defects keep their other marks; those outside the picture are none."""
    radiance, u, mask = images()
    mask[1, 1], mask[2, 2] = PixelMask.SATURATED, PixelMask.INCONSISTENT
    radiance[1, 1] = radiance[2, 3] = 1e6
    repair_defects(radiance, u, mask, [(2, 2), (3, 2), (-1, 0), (0, 5), (5, 5)])
    assert radiance[2, 2] == pytest.approx(np.mean([7, 8, 11, 16, 17, 18]))
    assert mask[2, 2] == PixelMask.DEFECTIVE | PixelMask.INCONSISTENT
    assert np.count_nonzero(mask & PixelMask.DEFECTIVE) == 2
    lonely = np.array([[5.0, 6.0]], np.float32), np.array([[0.1, 0.1]], np.float32), np.zeros((1, 2), np.uint8)
    repair_defects(*lonely, [(0, 0)])
    assert (lonely[0][0, 0], lonely[1][0, 0]) == (5.0, 5.0)
