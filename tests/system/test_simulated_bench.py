"""The main job on the simulated bench: calibrated on a source of known radiance, patches over five decades."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.acquire.bracketing import BracketRequest, plan_for_scene, take_plan
from radiometer.analysis.calibration.calibrate import scale_from_radiance
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    Flag,
    LensDescription,
    Patch,
    Scale,
    SensorNoise,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.devices import CameraCapabilities, CameraPreset, CameraSettings
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping

WIDTH, HEIGHT = 200, 160
LIMITS = CameraCapabilities((11e-6, 30.0), (0.0, 47.9), (0.0, 511.0), ("Mono12",), WIDTH, HEIGHT, True, True)
LENS = LensDescription(focal_length_mm=16, f_number=4.0, transmittance=0.95, vignetting="cos4")
CHART = {"kind": "step_chart", "steps": {"count": 20, "lowest": 1e-4, "highest": 10.0}}
REFERENCE_PATCH = Patch(60, 40, 80, 80)
REFERENCE_RADIANCE = 1.0
REFERENCE_U_REL = 0.001


def camera_before(scene, seed):
    """Return an open simulated camera before a scene."""
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LENS)
    camera = SimulatedCamera(model, scene_from_mapping(scene), seed=seed, limits=LIMITS)
    camera.open()
    camera.configure(CameraSettings(0.01, black_level_dn=64.0))
    return camera


def take(camera, region=None):
    """Return the bracket that the scene asks for."""
    request = BracketRequest(region=region, time_limit_s=200.0)
    return Bracket.from_frames(take_plan(camera, plan_for_scene(camera, request), request))


def calibrated_on(radiance, seed):
    """Return the calibration from a source believed to be REFERENCE_RADIANCE; but for that draw all is exact."""
    camera = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": radiance}, seed)
    unscaled = Calibration(
        camera.description,
        camera.lens,
        Scale(value=1.0, u_rel=0.0, method="known_radiance", f_number=4.0),
        None,
        SensorNoise.of(camera.description),
        black_level=BlackLevel(dn=64.0, u_dn=0.0, dark_u_rel=0.0),
        uncertainties=StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0)),
    )
    frames = take(camera, REFERENCE_PATCH)
    read = read_patch(frames, REFERENCE_PATCH, Setup(camera.description, camera.lens, unscaled)).radiance
    scale = scale_from_radiance(REFERENCE_RADIANCE, REFERENCE_U_REL, read.value, read.u_rel, 4.0)
    return replace(unscaled, scale=scale)


@pytest.fixture(scope="module", params=[4, pytest.param(20, marks=pytest.mark.long)])
def readings(request):
    """Return true radiance and reading of 20 patches for each of some seeds."""
    rows = []
    for seed in range(request.param):
        true_reference = REFERENCE_RADIANCE * (1 + REFERENCE_U_REL * np.random.default_rng(seed).standard_normal())
        calibration = calibrated_on(true_reference, 1000 + 2 * seed)
        camera = camera_before(CHART, 1001 + 2 * seed)
        bracket = take(camera)
        for patch in camera.scene.patches(WIDTH, HEIGHT):
            reading = read_patch(bracket, patch.patch, Setup(camera.description, camera.lens, calibration))
            rows.append((patch.radiance(), reading))
    return rows


def test_the_mean_error_stays_under_half_a_percent(readings):
    """20 patches over 5 decades: mean error of each and of all under 0.5 %; by chance one in a hundred is flagged."""
    errors = np.array([reading.radiance.value / true - 1 for true, reading in readings]).reshape(-1, 20)
    assert np.isfinite(errors).all()
    assert abs(errors.mean()) < 0.005
    assert np.abs(errors.mean(axis=0)).max() < 0.005
    flagged = [reading.flags for _, reading in readings if set(reading.flags) - {Flag.FEW_FRAMES}]
    assert len(flagged) <= 4


def test_the_stated_intervals_contain_the_truth(readings):
    """95 ± 4 % of the k = 2 intervals hold the truth; errors in units of their u scatter by 1."""
    covered = [abs(reading.radiance.value - true) <= 2 * reading.radiance.u for true, reading in readings]
    assert 0.91 <= np.mean(covered) <= (0.99 if len(covered) > 80 else 1.0)
    pulls = np.array([(reading.radiance.value - true) / reading.radiance.u for true, reading in readings])
    # The shared draws of the reference dominate: the standard deviation is known to 1/√40 = 16 % of 20, to 35 % of 4.
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=2.5 / np.sqrt(2 * pulls.size / 20))
