"""The simulated chain against theory, its stages, its checks, and what its header does not declare."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.errors import ConfigurationError, MeasurementError
from radiometer.units import gain_factor
from simulators.chain.bent_normal import bent_normal
from simulators.chain.camera_model import CameraModel
from simulators.chain.undeclared import Undeclared, completed, undeclared_chain
from simulators.effects.base import ELECTRONS, Effect, Stage, parameter
from simulators.effects.catalogue import declared_dark_e
from simulators.effects.context import FrameGeometry
from simulators.effects.registry import EFFECTS, make_effect

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
def model():
    return CameraModel.ideal(CAMERA, LensDescription(f_number=4.0))


def _pair(model, settings, radiance, seed):
    """Return mean and temporal variance of two frames by the pair method."""
    context = model.context(settings, GEOMETRY)
    scene = np.full(GEOMETRY.shape, radiance)
    first, second = (model.sample(scene, context, (seed, k)).dn.astype(float) for k in range(2))
    difference = first - second
    return float((first + second).mean() / 2), float(difference.var(ddof=1) / 2)


@pytest.mark.parametrize("gain_db", [0.0, 6.0, 12.0])
def test_slope_of_the_photon_transfer_is_the_system_gain(model, gain_db):
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
def test_read_noise_is_constant_in_electrons_and_rounding_in_dn(model, gain_db):
    """Variance of dark frames is (K·3)² + 1/12 at every gain."""
    _, variance = _pair(model, FrameSettings(1e-5, gain_db, 4.0, 64.0, shutter="closed"), 0.0, 2)
    expected = (3.0 * gain_factor(gain_db) / 2.6) ** 2 + 1 / 12
    assert variance == pytest.approx(expected, abs=4 * expected * np.sqrt(2 / N))


def test_shot_noise_is_poisson_in_its_third_moment(model):
    """Skewness of electrons at 25 e- is 1/√25, which no normal approximation has (4 standard deviations)."""
    context = model.context(FrameSettings(0.01, 0.0, 4.0, 64.0), GEOMETRY)
    rise_dn = model.mean(np.full((1, 1), 0.1), context) - model.mean(np.zeros((1, 1)), context)
    scene = np.full(GEOMETRY.shape, 0.1 * 25.0 / (2.6 * rise_dn[0, 0]))
    electrons = model.sample(scene, context, (5,)).electrons.astype(float)
    skewness = np.mean((electrons - electrons.mean()) ** 3) / electrons.std() ** 3
    assert skewness == pytest.approx(1 / np.sqrt(25.02), abs=4 * np.sqrt(6 / N))


def moments(middle, sigma, power, toe=0.0, lift=1.0, black=0.0):
    """Return mean, variance and slope over a range of 1000."""
    columns = (np.array([value]) for value in (middle, sigma, black, 1000.0))
    return tuple(float(values[0]) for values in bent_normal(*columns, power, toe, lift))


@pytest.mark.parametrize(("middle", "sigma"), [(200.0, 10.0), (200.0, 2.0), (50.0, 1.0)])
def test_a_square_has_the_moments_of_a_squared_normal_value(middle, sigma):
    """y = x²/1000: mean (m² + σ²)/1000, variance (4m²σ² + 2σ⁴)/1000², slope 2m/1000."""
    expected = ((middle**2 + sigma**2) / 1e3, (4.0 * middle**2 * sigma**2 + 2.0 * sigma**4) / 1e6, 2.0 * middle / 1e3)
    assert moments(middle, sigma, 2.0) == pytest.approx(expected, rel=1e-9)
    mirrored = moments(-middle, sigma, 2.0)
    assert mirrored == pytest.approx((-expected[0], expected[1], expected[2]), rel=1e-9)


def test_a_root_is_that_of_draws_and_its_straight_beginning_exact():
    """A power 0.8 to half a per cent about its corner; many values as each alone."""
    z = np.random.default_rng(4).standard_normal(2_000_000)
    for middle in (0.0, 4.0, 12.0):
        value = middle + 6.0 * z
        bent = 1000.0 * np.copysign(np.abs(value / 1000.0) ** 0.8, value)
        mean, variance, slope = moments(middle + 15.0, 6.0, 0.8, black=15.0)
        assert mean - 15.0 == pytest.approx(bent.mean(), abs=0.005 * bent.std())
        assert variance == pytest.approx(bent.var(), rel=0.005)
        assert slope == pytest.approx(np.mean(z * bent) / 6.0, rel=0.005)
    toe, power = 0.05, 0.5
    lift = toe ** (power - 1.0)
    for middle in (0.0, 5.0, -20.0):
        assert moments(middle, 3.0, power, toe, lift) == pytest.approx((lift * middle, 9.0 * lift**2, lift), rel=1e-12)
    rng = np.random.default_rng(1)
    middle, sigma = rng.uniform(-20.0, 900.0, 1500), rng.uniform(0.5, 20.0, 1500)
    black, room = np.full(1500, 10.0), np.full(1500, 1000.0)
    together = np.array(bent_normal(middle, sigma, black, room, 0.7, 0.0, 1.0))
    for at in (0, 511, 512, 1499):
        alone = moments(float(middle[at]), float(sigma[at]), 0.7, black=10.0)
        assert together[:, at] == pytest.approx(alone, rel=1e-12)


# The camera model: its stages, its checks, and what its header does not declare.


STAGED = CAMERA.model_copy(update={"read_noise_e": 2.4, "full_well_e": 10_500, "dark_current_e_per_s": 1.0})

LENS = LensDescription(focal_length_mm=16, f_number=4.0, transmittance=0.95)

SETTINGS = FrameSettings(exposure_s=0.01, f_number=4.0, black_level_dn=64.0)


@pytest.fixture
def staged():
    return CameraModel.ideal(STAGED, LENS)


@dataclass(frozen=True)
class Broken(Effect):
    """Fails when it runs."""

    name = "broken"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    depth: float = parameter(0.5, "1", 0.0, 1.0, source="test")

    def mean(self, signal, context):
        raise ValueError("out of coffee")


@dataclass(frozen=True)
class NotFinite(Broken):
    """Gives NaN without raising."""

    name = "not_finite"

    def mean(self, signal, context):
        return np.full_like(signal, np.nan)


def test_mean_follows_the_equations_from_radiance_to_dn(staged):
    """By hand; binning sums four pixels, 45° leaves a quarter."""
    context = staged.context(SETTINGS, FrameGeometry.of_image(4, 3))
    irradiance = np.pi * 0.95 * 0.5 / (4 * 4.0**2)
    photon_j = 6.62607015e-34 * 299_792_458.0 / 550e-9
    electrons = 0.62 * irradiance * 0.01 * (4.5e-6) ** 2 / photon_j + 1.0 * 0.01
    expected = electrons / 2.6 + 64.0
    assert staged.mean(np.full((3, 4), 0.5), context) == pytest.approx(np.full((3, 4), expected), rel=1e-12)
    single = staged.context(SETTINGS, FrameGeometry.of_image(1, 1))
    binned = staged.context(SETTINGS, FrameGeometry.of_image(1, 1, binning=2))
    radiance = np.full((1, 1), 0.4)
    until = Stage.WELL
    assert staged.mean(radiance, binned, until)[0, 0] == pytest.approx(4 * staged.mean(radiance, single, until)[0, 0])
    assert staged.mean(np.full((1, 1), 99.0), binned, until)[0, 0] == pytest.approx(4 * 10_500)
    lens = LensDescription(focal_length_mm=4.5, f_number=4.0, vignetting="cos4", principal_point_px=(0.0, 0.0))
    staged = CameraModel.ideal(STAGED, lens)
    geometry = FrameGeometry.of_image(1001, 1, principal_point_px=(0.0, 0.0), pixel_spacing_um=4.5)
    irradiance = staged.mean(np.ones((1, 1001)), staged.context(SETTINGS, geometry), until=Stage.OPTICS)
    assert irradiance[0, 1000] / irradiance[0, 0] == pytest.approx(0.25, rel=1e-12)


@pytest.mark.parametrize(
    ("level_e", "full_well_e"),
    [(0.0, 10_500), (400.0, 10_500), (9000.0, 10_500), (7950.0, 8000), (8100.0, 8000), (10_400.0, 20_000)],
)
def test_samples_have_the_predicted_moments(staged, level_e, full_well_e):
    """Mean and variance of 160 000 pixels agree with `moments` within 4 standard errors, also on either limit."""
    staged = staged.with_parameters("full_well_saturation", full_well_e=full_well_e)
    geometry = FrameGeometry.of_image(400, 400)
    context = staged.context(SETTINGS, geometry)
    per_radiance = staged.mean(np.ones((1, 1)), context, until=Stage.ELECTRONS)[0, 0] - 0.01
    radiance = np.full(geometry.shape, level_e / per_radiance)
    expected = staged.moments(radiance[:1, :1], context)
    pixels = staged.sample(radiance, context, seed=(1,)).dn.astype(float)
    variance = float(expected.variance[0, 0])
    # A censored normal stands for a censored Poisson count: its skewness 1/√μ is worth up to 1 % of σ.
    censored = level_e > 7900.0 and level_e != 9000.0
    u_mean = np.sqrt(variance / pixels.size) + (0.01 / 4 * np.sqrt(variance) if censored else 0.0)
    assert pixels.mean() == pytest.approx(expected.mean[0, 0], abs=4 * u_mean)
    fourth = np.mean((pixels - pixels.mean()) ** 4)
    u_variance = np.sqrt((fourth - pixels.var() ** 2) / pixels.size)
    assert pixels.var() == pytest.approx(variance, abs=4 * u_variance + (0.01 * variance if censored else 0.0))


def test_noise_of_one_effect_does_not_depend_on_another(staged):
    """With read noise switched off, the shot noise of the frame stays the same."""
    context = staged.context(SETTINGS, FrameGeometry.of_image(32, 32))
    radiance = np.full((32, 32), 0.3)
    noisy, quiet = (
        staged.sample(radiance, context, (3,)),
        staged.without_effect("read_noise").sample(radiance, context, (3,)),
    )
    assert np.array_equal(noisy.electrons, quiet.electrons)
    assert not np.array_equal(noisy.dn, quiet.dn)


def test_a_chain_that_cannot_run_names_the_effect(staged):
    """The one after a hole, one that fails, and one that gives NaN."""
    with pytest.raises(ConfigurationError, match=r"'photon_conversion'.*takes J m-2.*'lens' before it gives W m-2"):
        staged.without_effect("shutter")
    context = staged.context(SETTINGS, FrameGeometry.of_image(2, 2))
    with pytest.raises(MeasurementError, match=r"effect 'broken' failed: out of coffee"):
        staged.with_effect(Broken()).sample(np.ones((2, 2)), context, (0,))
    with pytest.raises(MeasurementError, match=r"effect 'not_finite' gave values that are not finite"):
        staged.with_effect(NotFinite()).mean(np.ones((2, 2)), context)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("lens", {"transmittance": 1.5}, r"transmittance = 1\.5 is out of range; allowed is 0\.01 to 1$"),
        ("lense", {}, r"no effect 'lense'; known are .*lens"),
        ("lens", {"colour": 1}, r"'lens' has no parameter 'colour'; it has transmittance"),
    ],
)
def test_an_effect_that_cannot_be_is_refused_with_what_there_is(name, values, message):
    """A value with its limits, a misspelt name with the known ones."""
    with pytest.raises(ConfigurationError, match=message):
        make_effect(name, values)


def test_model_file_gives_the_same_model_back(staged, tmp_path):
    """Written and read again, every entry, switch and value is there."""
    changed = staged.with_effect(make_effect("dark_current", {"rate_e_per_s": 3.0}), notes={"evidence_nats": 41.5})
    changed = changed.without_effect("read_noise")
    changed.write(tmp_path / "model.yaml")
    again = CameraModel.read(tmp_path / "model.yaml")
    assert again.to_mapping() == changed.to_mapping()
    assert [e.enabled for e in again.entries if e.effect.name == "read_noise"] == [False]


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_is_registered_under_its_name_with_bounded_sourced_parameters(name):
    """A registry line and its class agree; each parameter has a unit, a source and a default within bounds."""
    kind = EFFECTS[name]
    assert kind.name == name
    made = kind()
    for known in kind.parameters():
        assert isinstance(known.unit, str)
        assert known.unit
        assert known.source
        assert known.low < known.high
        default = getattr(made, known.name)
        for value in default if isinstance(default, tuple) else (default,):
            assert known.low <= value <= known.high


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_output_depth_scales_black_level_and_signal(staged, bits):
    """The same light gives 2^(b − 12) times as many DN in an output of b bits."""
    geometry = FrameGeometry.of_image(2, 2)
    native = staged.mean(np.full((2, 2), 0.4), staged.context(SETTINGS, geometry))
    output = staged.mean(np.full((2, 2), 0.4), staged.context(SETTINGS, geometry, output_bit_depth=bits))
    assert output == pytest.approx(native * 2.0 ** (bits - 12), rel=1e-12)


@pytest.mark.parametrize(("binning", "temperature_c"), [(1, None), (2, None), (2, 39.0), (1, 18.0)])
def test_declared_dark_charge_is_what_the_chain_collects(staged, binning, temperature_c):
    """What effects take for declared is what a frame without light holds: 1 e⁻/s at 25 °C, twice that every 7 K."""
    settings = replace(SETTINGS, temperature_c=temperature_c)
    context = staged.context(settings, FrameGeometry.of_image(1, 1, binning=binning))
    dark = staged.mean(np.zeros((1, 1)), context, until=Stage.WELL)[0, 0]
    warmer = 2.0 ** ((25.0 if temperature_c is None else temperature_c) / 7.0 - 25.0 / 7.0)
    assert declared_dark_e(context) == pytest.approx(0.01 * warmer * binning**2, rel=1e-12)
    assert dark == pytest.approx(0.01 * warmer * binning**2, rel=1e-6)


def test_figures_stay_within_what_a_camera_can_have():
    """A step of a fit ends at the bound; declared ones beyond it are refused."""
    camera = CameraDescription(bit_depth=12)
    assert completed(camera, Undeclared(log_gain=30.0)).conversion_gain_e_per_dn == 1e-4
    far = completed(camera, Undeclared(log_gain=-30.0, log_read=60.0))
    assert (far.conversion_gain_e_per_dn, far.read_noise_e, far.full_well_e) == (1e4, 1e4, 1e7)
    near = completed(camera, Undeclared(log_gain=np.log(2.0), log_read=2.0 * np.log(3.0)))
    assert (near.conversion_gain_e_per_dn, near.read_noise_e) == pytest.approx((1.25, 15.0))
    assert near.full_well_e == pytest.approx(4.0 * 4095 * 1.25)
    camera = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2e4)
    with pytest.raises(ConfigurationError, match=r"conversion_gain_e_per_dn = 20000 .* is out of range"):
        undeclared_chain(camera, LensDescription(), Undeclared(), np.zeros(1, dtype=np.intp), ends_in_well=True)
