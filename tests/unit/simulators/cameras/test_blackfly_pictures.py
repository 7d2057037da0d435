from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiometer.data import LensDescription
from radiometer.devices import CameraPreset
from simulators.cameras.blackfly_pictures import ForwardModelSource, PictureRequest, PooledSource
from simulators.cameras.blackfly_processing import gamma_corrected, sharpened, steered
from simulators.chain.camera_model import CameraModel
from simulators.chain.virtual_sensor import VirtualSensor
from simulators.scenes.factory import scene_from_mapping

REQUEST = PictureRequest(
    exposure_s=0.01,
    gain_db=0.0,
    black_level_dn=64.0,
    bit_depth=12,
    temperature_c=40.0,
    source_level=1.0,
    is_shutter_closed=False,
    binning=1,
    x=0,
    y=0,
    width=64,
    height=48,
)


def sensor() -> VirtualSensor:
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LensDescription(f_number=4.0))
    return VirtualSensor(model, scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.2}), 64, 48, seed=5)


def test_a_region_is_the_whole_picture_cut():
    """A region of a frame holds the very pixels that the whole frame has there."""
    whole = ForwardModelSource(sensor())(REQUEST)
    part = ForwardModelSource(sensor())(replace(REQUEST, x=8, y=4, width=16, height=10))
    np.testing.assert_array_equal(part, whole[4:14, 8:24])


def test_a_closed_shutter_leaves_the_black_level():
    """With the shutter closed only black level and dark signal remain."""
    dark = ForwardModelSource(sensor())(replace(REQUEST, is_shutter_closed=True))
    sigma = np.hypot(5.4 / 5.95, 0.29) / np.sqrt(dark.size)
    assert dark.mean() == pytest.approx(64.0, abs=5 * sigma + 0.01)  # dark signal: 0.04 e⁻


def test_the_source_level_scales_the_light():
    """Half the drive gives half the signal, within 5 sigma of the means."""
    full = ForwardModelSource(sensor())(REQUEST).mean() - 64
    half = ForwardModelSource(sensor())(replace(REQUEST, source_level=0.5)).mean() - 64
    assert half / full == pytest.approx(0.5, abs=5 * 0.75 / np.sqrt(full * 5.95 * 64 * 48))


def test_a_pool_is_drawn_anew_when_settings_change():
    """A pool repeats its frames under one setting, and never shows a frame of another."""
    made = []

    def source(request: PictureRequest) -> np.ndarray:
        made.append(request)
        return np.full((2, 2), len(made), np.uint16)

    pooled = PooledSource(source, 2)
    assert [int(pooled(REQUEST)[0, 0]) for _ in range(5)] == [1, 2, 1, 2, 1]
    assert int(pooled(replace(REQUEST, exposure_s=0.02))[0, 0]) == 3


def test_gamma_keeps_black_and_full_scale():
    """Gamma bends what lies between and leaves the ends."""
    bent = gamma_corrected(np.array([0, 1024, 4095], np.uint16), 0.5, 4095)
    assert bent.tolist() == [0, round(4095 * (1024 / 4095) ** 0.5), 4095]


def test_sharpening_steepens_an_edge_and_leaves_a_plane():
    """An edge overshoots; an even field stays."""
    edge = np.repeat(np.array([[100] * 4 + [200] * 4], np.uint16), 6, axis=0)
    crisp = sharpened(edge, 4095)
    assert crisp[3, 3] < 100
    assert crisp[3, 4] > 200
    assert crisp[3, 0] == 100


def test_automatic_exposure_moves_towards_half_of_full_scale():
    """Too dark lengthens, too bright shortens, by a factor of two at most and within the limits."""
    assert steered(0.01, 1000, 4095, 1e-5, 30) == pytest.approx(0.02)
    assert steered(0.01, 4000, 4095, 1e-5, 30) == pytest.approx(0.01 * 0.5 * 4095 / 4000)
    assert steered(20.0, 10, 4095, 1e-5, 30) == 30
