"""The simulated chain against theory, and its bent normal distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.units import gain_factor
from simulators.chain.bent_normal import bent_normal
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


def moments(
    middle: float, sigma: float, power: float, toe: float = 0.0, lift: float = 1.0, black: float = 0.0
) -> tuple[float, ...]:
    """Return mean, variance and slope over a range of 1000."""
    columns = (np.array([value]) for value in (middle, sigma, black, 1000.0))
    return tuple(float(values[0]) for values in bent_normal(*columns, power, toe, lift))


@pytest.mark.parametrize(("middle", "sigma"), [(3.0, 2.0), (30.0, 2.0), (300.0, 2.0), (-300.0, 5.0)])
def test_a_straight_curve_changes_nothing(middle: float, sigma: float) -> None:
    """Power 1: mean, variance and slope stay, whichever nodes are used; black and range drop out."""
    for black in (0.0, 2.5):
        assert moments(middle, sigma, 1.0, black=black) == pytest.approx((middle, sigma**2, 1.0), rel=1e-6)


@pytest.mark.parametrize(("middle", "sigma"), [(200.0, 10.0), (200.0, 2.0), (50.0, 1.0)])
def test_a_square_has_the_moments_of_a_squared_normal_value(middle: float, sigma: float) -> None:
    """y = x²/1000: mean (m² + σ²)/1000, variance (4m²σ² + 2σ⁴)/1000², slope 2m/1000."""
    expected = ((middle**2 + sigma**2) / 1e3, (4.0 * middle**2 * sigma**2 + 2.0 * sigma**4) / 1e6, 2.0 * middle / 1e3)
    assert moments(middle, sigma, 2.0) == pytest.approx(expected, rel=1e-9)
    mirrored = moments(-middle, sigma, 2.0)
    assert mirrored == pytest.approx((-expected[0], expected[1], expected[2]), rel=1e-9)


def test_about_the_corner_a_root_is_that_of_draws() -> None:
    """Mean, variance and slope E[z·g]/σ of a power 0.8 within a sigma of its beginning, to half a per cent."""
    z = np.random.default_rng(4).standard_normal(2_000_000)
    for middle in (0.0, 4.0, 12.0):
        value = middle + 6.0 * z
        bent = 1000.0 * np.copysign(np.abs(value / 1000.0) ** 0.8, value)
        mean, variance, slope = moments(middle + 15.0, 6.0, 0.8, black=15.0)
        assert mean - 15.0 == pytest.approx(bent.mean(), abs=0.005 * bent.std())
        assert variance == pytest.approx(bent.var(), rel=0.005)
        assert slope == pytest.approx(np.mean(z * bent) / 6.0, rel=0.005)


def test_the_straight_beginning_is_exact() -> None:
    """Within the toe, all nodes included, y = lift·x: mean, variance lift²σ² and slope lift to rounding."""
    toe, power = 0.05, 0.5
    lift = toe ** (power - 1.0)
    for middle in (0.0, 5.0, -20.0):
        assert moments(middle, 3.0, power, toe, lift) == pytest.approx((lift * middle, 9.0 * lift**2, lift), rel=1e-12)


def test_at_the_end_of_the_toe_curve_and_line_meet_by_shares() -> None:
    """A value at the toe itself is half line, half root: its mean lies below the root's own by the bend's share."""
    toe, power, sigma = 0.05, 0.5, 2.0
    lift = toe ** (power - 1.0)
    mean, _, slope = moments(50.0, sigma, power, toe, lift)
    turn = (lift - power * toe ** (power - 1.0)) * sigma / math.sqrt(2.0 * math.pi)
    assert mean == pytest.approx(1000.0 * toe**power - turn, abs=0.1 * turn)
    assert slope == pytest.approx(0.5 * (lift + power * toe ** (power - 1.0)), rel=0.02)


def test_many_values_are_each_reported_as_if_alone() -> None:
    """More than are worked on at once, near and far mixed."""
    rng = np.random.default_rng(1)
    middle, sigma = rng.uniform(-20.0, 900.0, 1500), rng.uniform(0.5, 20.0, 1500)
    black, room = np.full(1500, 10.0), np.full(1500, 1000.0)
    together = np.array(bent_normal(middle, sigma, black, room, 0.7, 0.0, 1.0))
    for at in (0, 511, 512, 1499):
        alone = moments(float(middle[at]), float(sigma[at]), 0.7, black=10.0)
        assert together[:, at] == pytest.approx(alone, rel=1e-12)
