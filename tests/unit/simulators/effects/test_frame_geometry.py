"""Places of pixels: by hand for a frame of 8 × 6 pixels, cropped, binned, and with an axis that is not its middle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.effects.context import FrameGeometry

FRAME = FrameGeometry.of_image(8, 6, pixel_spacing_um=5.0)


def test_coordinates_count_pixels_of_the_sensor() -> None:
    """From 0 at the upper left; a crop begins at its corner, a binned pixel is in the middle of its four."""
    assert FRAME.x_px.tolist() == [list(range(8))]
    assert FRAME.y_px.tolist() == [[float(y)] for y in range(6)]
    assert FRAME.shape == (6, 8)
    assert FRAME.is_image
    binned = FrameGeometry.of_image(3, 2, x=10, y=20, binning=2)
    assert binned.x_px.tolist() == [[10.5, 12.5, 14.5]]
    assert binned.y_px.ravel().tolist() == [20.5, 22.5]
    assert (binned.sensor_width, binned.sensor_height) == (16, 24)


def test_the_axis_is_the_middle_or_as_stated() -> None:
    """Of 8 × 6 pixels 3.5 and 2.5; distances are in µm, in half diagonals, and as (x, y) of those."""
    assert FRAME.centre_px == (3.5, 2.5)
    assert FRAME.radius_um()[0, 0] == pytest.approx(5.0 * math.hypot(3.5, 2.5))
    assert FRAME.field_radius()[0, 0] == pytest.approx(math.hypot(3.5, 2.5) / 5.0)  # half of √(8² + 6²) is 5 px
    x, y = FRAME.field_xy()
    assert (float(x[0, 0]), float(y[0, 0])) == pytest.approx((-3.5 / 5.0, -2.5 / 5.0))
    assert np.hypot(x, y) == pytest.approx(FRAME.field_radius())
    neighbour = replace(FRAME, principal_point_px=(0.0, 0.0))
    assert neighbour.centre_px == (0.0, 0.0)
    assert neighbour.radius_um()[5, 7] == pytest.approx(5.0 * math.hypot(7.0, 5.0))


def test_sensor_and_screen_run_from_minus_one_to_one_over_the_longer_side() -> None:
    """Half of 8 pixels is 1; a screen turned by 90° exchanges its axes, a shifted one is next to it."""
    for x, y in (FRAME.sensor_xy(), FRAME.screen_xy()):
        assert np.broadcast_to(x, FRAME.shape)[0] == pytest.approx((np.arange(8) - 3.5) / 4.0)
        assert np.broadcast_to(y, FRAME.shape)[:, 0] == pytest.approx((np.arange(6) - 2.5) / 4.0)
    u, v = replace(FRAME, screen_rotation_rad=math.pi / 2).screen_xy()
    assert np.broadcast_to(u, FRAME.shape)[:, 0] == pytest.approx((np.arange(6) - 2.5) / 4.0)
    assert np.broadcast_to(v, FRAME.shape)[0] == pytest.approx(-(np.arange(8) - 3.5) / 4.0)
    u, v = replace(FRAME, screen_shift_px=(1.0, -2.0)).screen_xy()
    assert (float(u[0, 0]), float(v[0, 0])) == pytest.approx((-4.5 / 4.0, -0.5 / 4.0))


def test_rows_are_read_from_the_first_to_the_last() -> None:
    """0 and 1, and a frame of one row is read at once."""
    assert FRAME.row_fraction().ravel() == pytest.approx(np.arange(6) / 5.0)
    assert FrameGeometry.of_image(4, 1).row_fraction().tolist() == [[0.0]]
