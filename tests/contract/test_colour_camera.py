"""A camera with colour filters on the wire: its frames are the mosaic that it sees, and it says so."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.cameras.aravis_camera import open_camera
from radiometer.data import LensDescription
from radiometer.data.mosaic import COLOURS, plane_of
from radiometer.devices import CameraPreset
from simulators.cameras.blackfly_gige import BlackflyGige
from simulators.cameras.blackfly_pictures import ForwardModelSource
from simulators.cameras.colour_filters import ColourFilters
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("pixel_format", ["BayerRG12", "BayerRG8"])
def test_a_mosaic_comes_through_the_driver(aravis_installed, gige_port, pixel_format):
    """Of monochromatic light each plane is as bright as its filter lets through."""
    preset = CameraPreset.shipped("BFS-U3-19S4C")
    limits = replace(preset.require_limits("").capabilities(has_shutter=False), width=160, height=120)
    lens = LensDescription(focal_length_mm=16, f_number=4.0)
    scene = scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.3, "wavelength_nm": 530.0})
    filters = ColourFilters()
    camera = SimulatedCamera(CameraModel.ideal(preset.camera, lens), scene, limits=limits, filters=filters)
    served = BlackflyGige(ForwardModelSource(camera.sensor), limits, serial="22500078")
    with served, open_camera("22500078", lens=lens) as opened:
        opened.configure(replace(opened.settings, pixel_format=pixel_format, exposure_s=0.008, black_level_dn=0.0))
        frame = opened.capture()[0]
        assert opened.description.mosaic == "RGGB"
    seen = np.array([np.median(plane_of(frame.dn, "RGGB", colour)) for colour in COLOURS])
    passed = np.array([float(filters.responsivity(colour, np.array([530.0]))[0]) for colour in COLOURS])
    assert frame.bit_depth == int(pixel_format.removeprefix("BayerRG"))
    assert seen / seen[1] == pytest.approx(passed / passed[1], abs=0.02)
