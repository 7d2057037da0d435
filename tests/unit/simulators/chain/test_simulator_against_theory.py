"""The simulator's frames against EMVA 1288 theory: slope of the photon transfer, dark slope, full well, read noise."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.units import gain_factor
from simulators.chain.camera_model import CameraModel
from simulators.effects.context import FrameGeometry

GEOMETRY = FrameGeometry.of_image(300, 200)
N = 300 * 200
CAMERA = CameraDescription(
    bit_depth=12,
    pixel_pitch_um=4.5,
    conversion_gain_e_per_dn=2.6,
    read_noise_e=3.0,
    full_well_e=8000,
    dark_current_e_per_s=2.0,
    dark_current_reference_C=25,
    dark_current_doubling_K=7.0,
    black_level_dn=64,
    quantum_efficiency=0.62,
)


@pytest.fixture
def model() -> CameraModel:
    return CameraModel.ideal(CAMERA, LensDescription(f_number=4.0))


def _pair(model: CameraModel, settings: FrameSettings, radiance: float, seed: int) -> tuple[float, float]:
    """Return mean and temporal variance of two frames by the pair method."""
    context = model.context(settings, GEOMETRY)
    scene = np.full(GEOMETRY.shape, radiance)
    first, second = (model.sample(scene, context, (seed, k)).dn.astype(float) for k in range(2))
    difference = first - second
    return float((first + second).mean() / 2), float(difference.var(ddof=1) / 2)


@pytest.mark.parametrize("gain_db", [0.0, 6.0, 12.0])
def test_slope_of_the_photon_transfer_is_the_system_gain(model: CameraModel, gain_db: float) -> None:
    """Weighted fit of variance over mean at 12 levels: K = 10^(g/20)/2.6 within 4 predicted standard deviations."""
    gain = gain_factor(gain_db) / 2.6
    dark_settings = FrameSettings(0.01, gain_db, 4.0, 64.0, shutter="closed")
    dark_mean, dark_variance = _pair(model, dark_settings, 0.0, 99)
    exposures = np.linspace(0.1, 0.8, 12) * 0.01 * min(1.0, 3900 / gain / 8000 * 1.1)
    pairs = [_pair(model, FrameSettings(t, gain_db, 4.0, 64.0), 0.45, k) for k, t in enumerate(exposures)]
    x, y = np.array(pairs).T - np.array([[dark_mean], [dark_variance]])
    u = (y + dark_variance) * np.sqrt(2 / N)
    slope, sigma = np.sum(x * y / u**2) / np.sum(x**2 / u**2), 1 / np.sqrt(np.sum(x**2 / u**2))
    u_dark = dark_variance * np.sqrt(2 / N) * np.sum(x / u**2) / np.sum(x**2 / u**2)
    assert slope == pytest.approx(gain, abs=4 * np.hypot(sigma, u_dark))


@pytest.mark.parametrize("gain_db", [0.0, 12.0, 24.0])
def test_read_noise_is_constant_in_electrons_and_rounding_in_dn(model: CameraModel, gain_db: float) -> None:
    """Variance of dark frames is (K·3)² + 1/12 at every gain."""
    _, variance = _pair(model, FrameSettings(1e-5, gain_db, 4.0, 64.0, shutter="closed"), 0.0, 2)
    expected = (3.0 * gain_factor(gain_db) / 2.6) ** 2 + 1 / 12
    assert variance == pytest.approx(expected, abs=4 * expected * np.sqrt(2 / N))


def test_shot_noise_is_poisson_in_its_third_moment(model: CameraModel) -> None:
    """Skewness of electrons at 25 e- is 1/√25, which no normal approximation has (4 standard deviations)."""
    context = model.context(FrameSettings(0.01, 0.0, 4.0, 64.0), GEOMETRY)
    rise_dn = model.mean(np.full((1, 1), 0.1), context) - model.mean(np.zeros((1, 1)), context)
    scene = np.full(GEOMETRY.shape, 0.1 * 25.0 / (2.6 * rise_dn[0, 0]))
    electrons = model.sample(scene, context, (5,)).electrons.astype(float)
    skewness = np.mean((electrons - electrons.mean()) ** 3) / electrons.std() ** 3
    assert skewness == pytest.approx(1 / np.sqrt(25.02), abs=4 * np.sqrt(6 / N))


def test_switching_dark_current_off_takes_just_its_electrons_away(model: CameraModel) -> None:
    """The mean without dark current differs from the mean with it by just its electrons."""
    context = model.context(FrameSettings(30.0, 0.0, 4.0, 64.0, shutter="closed"), FrameGeometry.of_image(1, 1))
    without = model.without_effect("dark_current").mean(np.zeros((1, 1)), context)
    assert model.mean(np.zeros((1, 1)), context) - without == pytest.approx(np.full((1, 1), 60.0 / 2.6))
