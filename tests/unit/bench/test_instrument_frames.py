"""Which frames an instrument takes next to the plan: dark ones where they matter, short ones of a bright surround."""

from __future__ import annotations

from dataclasses import replace

import pytest

from radiometer.bench.instrument import Instrument
from radiometer.data import BlackLevel, Calibration, Flag, LensDescription, Patch, Scale, SensorNoise
from radiometer.devices import CameraCapabilities, CameraPreset, CameraSettings
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping

LENS = LensDescription(focal_length_mm=16, f_number=4.0, transmittance=0.95, vignetting="cos4")


def instrument(scene, *, shutter, **more):
    """Return an instrument with a small simulated camera; its calibration is of 1 J/m² per unit."""
    limits = CameraCapabilities((11e-6, 30.0), (0.0, 47.9), (0.0, 511.0), ("Mono12",), 48, 40, True, shutter)
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LENS)
    camera = SimulatedCamera(model, scene_from_mapping(scene), seed=3, limits=limits)
    camera.open()
    camera.configure(CameraSettings(0.01, black_level_dn=64.0))
    scale = Scale(value=1.0, u_rel=0.0, method="known_radiance", f_number=4.0)
    noise = SensorNoise.of(camera.description)
    calibration = Calibration(camera.description, LENS, scale, None, noise, BlackLevel(dn=64.0))
    return Instrument(camera, Patch(18, 14, 12, 12), calibration, clock=camera.clock.now_s, **more)


DIM = {"kind": "uniform", "radiance_W_per_sr_m2": 2e-4}
BRIGHT = {"kind": "uniform", "radiance_W_per_sr_m2": 1.0}


@pytest.mark.parametrize(("scene", "shutter", "dark"), [(DIM, True, True), (DIM, False, False), (BRIGHT, True, False)])
def test_dark_frames_are_taken_where_they_matter_and_can_be_had(scene, shutter, dark):
    """A dim patch with a shutter: two at each exposure; a bright one, or without a shutter, none."""
    taken = instrument(scene, shutter=shutter, time_limit_s=6.0).take_bracket()
    exposures = {frame.settings.exposure_s for frame in taken.light}
    assert sorted(f.settings.exposure_s for f in taken.dark) == (sorted([*exposures] * 2) if dark else [])


def test_dark_frames_take_the_data_sheet_s_doubt_away():
    """Read with dark frames, the dim patch is no longer flagged for its dark level."""
    without, shuttered = (instrument(DIM, shutter=shutter, time_limit_s=6.0).measure() for shutter in (False, True))
    assert Flag.DARK_ASSUMED in without.flags
    assert Flag.DARK_ASSUMED not in shuttered.flags


def test_a_cap_is_asked_for_and_taken_off_again():
    """By hand, whatever the light: covered once, uncovered once, dark frames in the bracket."""
    asked: list[bool] = []
    taken = replace(instrument(BRIGHT, shutter=False), cover=asked.append).take_bracket()
    assert asked == [True, False]
    assert taken.dark


def test_a_surround_that_clips_is_looked_at_in_shorter_frames():
    """The patch is 100 times dimmer than what is around it: the reading knows by how much, and says so."""
    scene = {
        "kind": "screen",
        "peak_radiance_W_per_sr_m2": 1.0,
        "gamma": 1.0,
        "background": 1.0,
        "patches": [{"name": "dim", "x": 12, "y": 8, "width": 24, "height": 24, "drive": 0.01}],
    }
    found = instrument(scene, shutter=False).measure()
    assert Flag.STRAY_LIGHT in found.flags
    stray = next(line for line in found.budget if line.name == "stray light")
    assert stray.u_rel == pytest.approx(7.5e-3 * (0.7 * 100 + 0.3 - 1), rel=0.05)
