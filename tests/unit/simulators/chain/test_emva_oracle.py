"""The simulator against the `emva1288` package: see emva_oracle.md."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from simulators.chain.camera_model import CameraModel, VirtualSensor
from simulators.effects.context import FrameGeometry
from simulators.scenes import UniformScene

HERE = Path(__file__).parent
K_TRUE = 1 / 5.95


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("make_emva_oracle", HERE / "make_emva_oracle.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def oracle():
    return json.loads((HERE / "emva_oracle.json").read_text())


@pytest.fixture(scope="module")
def model(script):
    return CameraModel.ideal(CameraDescription(**script.CAMERA), LensDescription(**script.LENS), script.WAVELENGTH_NM)


@pytest.fixture(scope="module")
def temporal(oracle):
    return {key: np.array(values) for key, values in oracle["temporal"].items()}


@pytest.fixture(scope="module")
def pixels(script):
    return int(script.WIDTH * script.HEIGHT)


def test_every_mean_and_variance_is_as_the_model_predicts(script, model, temporal, pixels):
    """Within 4.5 predicted standard deviations; the first pairs, exposed again, have the very means."""
    scene = UniformScene(radiance_W_per_sr_m2=script.RADIANCE, wavelength_nm=script.WAVELENGTH_NM)
    sensor = VirtualSensor(model, scene, script.WIDTH, script.HEIGHT, seed=script.SEED)
    for step, t in enumerate(script.exposures_s()[:2]):
        for shutter, key in (("open", "u_y"), ("closed", "u_ydark")):
            settings = FrameSettings(t, f_number=4.0, black_level_dn=64.0, shutter=shutter)
            mean = np.mean([sensor.expose(settings) for _ in range(2)])
            assert mean == pytest.approx(temporal[key][step], abs=1e-9)
    for t, u_y, s2_y in zip(script.exposures_s(), temporal["u_y"], temporal["s2_y"], strict=True):
        settings = FrameSettings(t, f_number=4.0, black_level_dn=64.0)
        context = model.context(settings, FrameGeometry.of_image(1, 1))
        expected = model.moments(np.full((1, 1), script.RADIANCE), context)
        variance = float(expected.variance[0, 0])
        # Next to full well a censored normal stands for a censored Poisson count (skewness 1/√20 000).
        model_error = 0.02 if t > 22.0 else 0.0
        assert u_y == pytest.approx(expected.mean[0, 0], abs=4.5 * np.sqrt(variance / 2 / pixels) + model_error * 5)
        assert s2_y == pytest.approx(variance, abs=variance * (4.5 * np.sqrt(2 / pixels) + model_error) + 0.1)


def test_the_package_finds_the_figures_that_were_simulated(temporal, oracle, pixels, script, model):
    """Within 4 sigmas; saturation at the largest predicted variance, ±3 steps."""
    signal = temporal["u_y"] - temporal["u_ydark"]
    used = signal <= 0.7 * signal.max()
    variances = temporal["s2_y"][used] ** 2 + temporal["s2_ydark"][used] ** 2
    sigma = np.sqrt(np.sum(signal[used] ** 2 * 2 * variances / pixels)) / np.sum(signal[used] ** 2)  # unweighted fit
    assert sigma < 2e-3 * K_TRUE
    for name, true in (("K", K_TRUE), ("QE", 62.0), ("sigma_d", 5.4), ("u_I_mean", 4.0)):
        assert oracle["figures"][name] == pytest.approx(true, rel=4 * 2e-3), name
    assert max(abs(oracle["figures"][name]) for name in ("LE_min", "LE_max")) < 0.05  # %
    settings = [FrameSettings(t, f_number=4.0, black_level_dn=64.0) for t in script.exposures_s()]
    geometry, radiance = FrameGeometry.of_image(1, 1), np.full((1, 1), script.RADIANCE)
    variances = [float(model.moments(radiance, model.context(s, geometry)).variance[0, 0]) for s in settings]
    photons = script.photons_per_second() * settings[int(np.argmax(variances))].exposure_s
    assert oracle["figures"]["u_p_sat"] == pytest.approx(photons, rel=3 * 0.003)
