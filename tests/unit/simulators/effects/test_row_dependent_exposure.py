"""Exposure that depends on the row, and the geometry of a frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.chain.camera_model import CameraModel
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.parasitic_light_sensitivity import ParasiticLightSensitivity
from simulators.effects.row_dependent_exposure import RowDependentExposure
from testing.effect_context import effect_context

ROWS = 96


def _at(exposure_s: float) -> ExposureContext:
    context = effect_context()
    geometry = FrameGeometry.of_image(40, ROWS)
    return replace(context, settings=replace(context.settings, exposure_s=exposure_s), geometry=geometry)


@pytest.mark.parametrize("exposure_s", [158e-6, 472.5e-6, 1.8e-3])
def test_rows_are_exposed_as_the_maker_s_model_says(exposure_s: float) -> None:
    """For L ∝ V/(t + a₂·y − a₃·t·y) the digital value of an even field goes as (t + a₂·y − a₃·t·y)/t in row y."""
    a2, a3 = 9.2e-8 * 10, 1.58e-5 * 10  # a RedEdge's, per row of a tenth of its rows
    y = np.arange(ROWS)
    reported = (exposure_s + a2 * y - a3 * exposure_s * y) / exposure_s
    effect = RowDependentExposure(added_s=a2 * (ROWS - 1), lost_share=a3 * (ROWS - 1))
    factor = np.asarray(effect.factor(_at(exposure_s)))
    np.testing.assert_allclose(np.ravel(factor), reported, rtol=1e-12)


def test_frames_have_rows_of_that_light() -> None:
    """The last tenth of the rows of 40 frames against the first tenth, within 5 sigma of the shot noise."""
    context, effect = _at(1e-3), RowDependentExposure(added_s=-2e-4, lost_share=0.05)
    model = CameraModel.ideal(context.camera, context.lens).with_effect(effect)
    scene = np.full((ROWS, 40), 0.5 * _half_full(context))
    ideal = model.without_effect(effect.name).moments(scene, context)
    black = context.settings.black_level_dn or 0.0
    dn = np.mean([model.sample(scene, context, (n,)).dn for n in range(40)], axis=0)
    first, last = dn[:10], dn[-10:]
    plain = float(np.mean(ideal.mean)) - black
    u = float(np.sqrt(np.mean(ideal.variance) / 40 / first.size)) / plain
    down = np.arange(ROWS) / (ROWS - 1)
    reported = 1.0 - 0.25 * down
    assert (first.mean() - black) / plain == pytest.approx(reported[:10].mean(), abs=5 * u)
    assert (last.mean() - black) / plain == pytest.approx(reported[-10:].mean(), abs=5 * u)


def _half_full(context: ExposureContext) -> float:
    model = CameraModel.ideal(context.camera, context.lens)
    lit = float(np.mean(model.moments(np.ones((ROWS, 40)), context).mean))
    dark = float(np.mean(model.moments(np.zeros((ROWS, 40)), context).mean))
    return 2000.0 / (lit - dark)


def test_no_row_is_exposed_for_less_than_nothing() -> None:
    """Where more time is taken away than there is, the row stays dark."""
    factor = np.asarray(RowDependentExposure(added_s=-2e-4).factor(_at(1e-4)))
    assert factor.min() == 0.0
    assert factor.max() == 1.0


def test_time_alone_is_what_leaking_light_does() -> None:
    """Without a share that goes with the exposure it is the leak's equation: no data can tell them apart."""
    context = _at(3e-4)
    row = np.asarray(RowDependentExposure(added_s=1e-5).factor(context))
    leak = np.asarray(ParasiticLightSensitivity(leak_s=1e-5).factor(context))
    np.testing.assert_allclose(row, leak, rtol=1e-7)


def test_a_leak_takes_no_light_away() -> None:
    """The leak's range begins at nothing; the exposure of rows may go either way."""
    leak = next(entry for entry in ParasiticLightSensitivity.parameters() if entry.name == "leak_s")
    added = next(entry for entry in RowDependentExposure.parameters() if entry.name == "added_s")
    assert leak.low == 0.0
    assert added.low < 0.0 < added.high


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
