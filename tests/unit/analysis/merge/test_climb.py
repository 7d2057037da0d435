"""Steps towards the movement of highest correlation, held against OpenCV's and against movements that were made."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from radiometer.analysis.merge.alignment import Climb
from radiometer.errors import MeasurementError

STILL = np.eye(2, 3)


def scene(seed=1, shape=(150, 200)):
    """Return a smooth picture in DN."""
    rough = np.random.default_rng(seed).normal(0.0, 400.0, shape).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(rough, (0, 0), 3.0) + 100.0, np.float32)


def place(right, down, degrees):
    """Return a movement."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[cos, -sin, right], [sin, cos, down]])


def moved(picture, movement):
    """Return the picture that shows at each pixel's new place what the given one shows at the pixel."""
    size = picture.shape[::-1]
    return np.asarray(cv2.warpAffine(picture, movement, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))


@pytest.mark.parametrize("movement", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.0), (1.5, 0.7, 0.4), (-2.0, 1.0, -0.8)])
def test_the_movement_that_was_made_is_found(movement):
    """To two of the 32nd parts of a pixel that OpenCV moves pictures by."""
    here, there = scene(), moved(scene(), place(*movement))
    correlation, found = Climb(here, there, np.ones(here.shape, np.uint8)).climbed(STILL, 60)
    assert found == pytest.approx(place(*movement), abs=0.0625)
    assert correlation > 0.99


@pytest.mark.parametrize("pedestal_dn", [0.0, 3000.0, 30000.0])
@pytest.mark.parametrize("left_out", ["nothing", "a rim", "a patch"])
def test_little_contrast_on_a_pedestal_is_climbed(pedestal_dn, left_out):
    """Thirty DN about a black level not subtracted, whatever is left out: to a tenth of a pixel at the corners.

    Up to the edges of the picture: beyond them is no light of 0 DN.
    """
    movement = place(1.5, 0.7, 0.4)
    here, there = (0.75 * picture - 75.0 for picture in (scene(4), moved(scene(4), movement)))
    assert here.std() == pytest.approx(30.0, rel=0.2)
    inside = np.full(here.shape, left_out != "a rim", np.uint8)
    inside[8:-8, 8:-8] = 1
    if left_out == "a patch":
        inside[40:70, 90:160] = 0
        there[45:65, 95:155] += 200.0
    here, there = (np.asarray(one + pedestal_dn, np.float32) for one in (here, there))
    correlation, found = Climb(here, there, inside).climbed(STILL, 60)
    corners = np.array([(0.0, 0.0, 1.0), (199.0, 0.0, 1.0), (0.0, 149.0, 1.0), (199.0, 149.0, 1.0)])
    assert np.linalg.norm(corners @ (found - movement).T, axis=1).max() < 0.1
    assert correlation > 0.99


def test_a_start_is_left_as_it_is():
    """A climb may be made again from the same place."""
    here, start = scene(), place(0.4, 0.0, 0.1)
    pair, kept = Climb(here, moved(here, place(1.0, 0.0, 0.0)), np.ones(here.shape, np.uint8)), start.copy()
    first, again = (pair.climbed(start, 5) for _ in range(2))
    assert np.array_equal(start, kept)
    assert first[0] == again[0]
    assert np.array_equal(first[1], again[1])


@pytest.mark.parametrize("way", ["flat", "opposite", "nothing shown"])
def test_pictures_that_are_not_alike_are_reported(way):
    """One without structure, one whose bright is the other's dark, and two of which nothing is shown."""
    here = scene()
    there = {"flat": np.full_like(here, 80.0), "opposite": 200.0 - here, "nothing shown": here}[way]
    inside = np.full(here.shape, way != "nothing shown", np.uint8)
    with pytest.raises(MeasurementError):
        Climb(here, there, inside).climbed(STILL, 15)


def test_stripes_are_left_where_they_are():
    """A picture of one slope and its copy: no step is the right one along the stripes, and none is made."""
    stripes = np.tile(100.0 + 50.0 * np.sin(np.arange(160.0) / 8.0), (90, 1)).astype(np.float32)
    correlation, found = Climb(stripes, stripes, np.ones(stripes.shape, np.uint8)).climbed(STILL, 5)
    assert correlation == pytest.approx(1.0, abs=1e-6)
    assert found == pytest.approx(STILL, abs=1e-4)
