"""The numbers of the thesis, to the digits given, and the right conversions next to them."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from radiometer.analysis.calibration import calibrate
from radiometer.analysis.calibration.calibrate import MeterSettings
from radiometer.analysis.photometry import photometry
from radiometer.analysis.photometry.photometry import Spectrum, spectrum, table
from radiometer.errors import InputError
from testing.golden import thesis

EXACT_K = [16.6016, 16.6016, 18.6346, 14.6417, 14.6417, 16.4347]
REFERENCE = MeterSettings(1 / 125, 16.0, thesis.MEASURED_ISO)


@pytest.mark.parametrize(("luminance", "f_number", "exposure_s", "expected"), thesis.METER_CONSTANTS)
def test_meter_constants_of_the_thesis(luminance, f_number, exposure_s, expected):
    """Printed settings taken at face value give the table's six constants."""
    constant = calibrate.meter_constant(luminance, MeterSettings(exposure_s, f_number, thesis.MEASURED_ISO))
    assert round(constant, 4) == expected


def test_the_mean_meter_constant_of_the_thesis():
    """The six average to 16.5."""
    rows = [(level, MeterSettings(t, n, thesis.MEASURED_ISO)) for level, n, t, _ in thesis.METER_CONSTANTS]
    constants = [calibrate.meter_constant(level, setting) for level, setting in rows]
    assert round(float(np.mean(constants)), 1) == thesis.MEAN_METER_CONSTANT


@pytest.mark.parametrize(("row", "expected"), list(zip(thesis.METER_CONSTANTS, EXACT_K, strict=True)))
def test_exact_stops_take_the_rounding_out_of_the_constants(row, expected):
    """f/16 and f/5.6 then agree to all digits; f/1.7 stays higher by one sixth of a stop."""
    luminance, f_number, exposure_s, _ = row
    constant = calibrate.meter_constant(luminance, MeterSettings(exposure_s, f_number, thesis.MEASURED_ISO).exact())
    assert round(constant, 4) == expected


def test_luminance_of_the_thesis():
    """K = 16.5, f/16, 1/125 s, ISO 136."""
    found = calibrate.metered_luminance_cd_m2(thesis.MEAN_METER_CONSTANT, REFERENCE)
    assert round(found, 4) == thesis.REFERENCE_LUMINANCE


def test_spectral_radiance_of_the_thesis():
    """Equation (2.10): 53.2234, per µm."""
    luminance = calibrate.metered_luminance_cd_m2(thesis.MEAN_METER_CONSTANT, REFERENCE)
    value = photometry.radiance_thesis_w_sr_m2_um(luminance)
    # The printed figure is the result cut, not rounded, after the fourth decimal.
    assert math.floor(value * 1e4) / 1e4 == thesis.REFERENCE_SPECTRAL_RADIANCE


def test_reference_exposure_of_the_thesis():
    """ln H = −6.6406; the thesis's 1.30624e-3 J/m² is the exponential of that rounded logarithm."""
    exposure = calibrate.reference_exposure_j_m2(thesis.REFERENCE_SPECTRAL_RADIANCE, REFERENCE)
    assert round(math.log(exposure), 4) == thesis.REFERENCE_LOG_EXPOSURE
    assert f"{math.exp(round(math.log(exposure), 4)):.5e}" == f"{thesis.REFERENCE_EXPOSURE_J_M2:.5e}"
    assert exposure == pytest.approx(thesis.REFERENCE_EXPOSURE_J_M2, rel=1e-4)


def test_the_pixel_of_the_thesis():
    """H = 1.792e-3 J/m² in 1/250 s through f = 20 mm, d = 3.571 mm."""
    assert round(1.792e-3 * 250, 3) == 0.448
    assert round(calibrate.radiance_of_exposure_w_sr_m2(1.792e-3, 1 / 250, 3.571e-3, 20e-3), 3) == 17.892


def test_the_gaussian_lies_where_the_eye_s_sensitivity_lies():
    """Its mean wavelength is within 1.5 nm of the CIE curve's 560.2 nm (the CIE curve leans), and it is off by 6 %."""
    wavelength, gaussian = photometry.luminous_efficiency("photopic_gaussian")
    _, table = photometry.luminous_efficiency()
    means = [float(curve @ wavelength / curve.sum()) for curve in (gaussian, table)]
    assert means[0] == pytest.approx(means[1], abs=1.5)
    assert float(np.abs(gaussian - table).max()) < 0.065


def test_the_gaussian_has_the_area_of_the_thesis():
    """∫V dλ of (2.9) is 0.1068 µm; the tabulated V(λ) has 0.10686 µm."""
    wavelength, gaussian = photometry.luminous_efficiency("photopic_gaussian")
    assert round(float(np.trapezoid(gaussian, wavelength * 1e-3)), 4) == 0.1068
    _, tabulated = photometry.luminous_efficiency("photopic")
    assert float(tabulated.sum()) == pytest.approx(106.856917, abs=1e-5)


def test_the_scotopic_table_is_the_published_one():
    """∫V′ dλ is 97.0713 nm and the peak lies at 507 nm."""
    wavelength, scotopic = photometry.luminous_efficiency("scotopic")
    assert float(scotopic.sum()) == pytest.approx(97.071317, abs=1e-5)
    assert abs(wavelength[np.argmax(scotopic)] - 507) <= 1


def test_the_thesis_conversion_is_the_radiance_of_one_micrometre():
    """Times the 0.4 µm of the band it is the equal-energy radiance: (2.10) is per µm."""
    right = photometry.radiance_w_sr_m2(3882.3529, spectrum("equal_energy"))
    assert right == pytest.approx(photometry.radiance_thesis_w_sr_m2_um(3882.3529) * 0.4, rel=1e-3)


@pytest.mark.parametrize(
    "name",
    [
        "moonlight",
        "planck:hot",
        "planck:499",
        "display:oled:purple",
        "display:oled",
        "display:slate:red",
        "planck:50001",
        "line:",
        "line:199",
        "line:2001",
        "nowhere.csv",
    ],
)
def test_an_unknown_spectrum_is_refused(name):
    """With the names there are, or what is wrong with the number or file."""
    with pytest.raises(InputError):
        spectrum(name)


def test_invisible_light_has_no_luminance():
    """An infrared line is refused rather than divided by zero."""
    with pytest.raises(InputError, match="no visible light"):
        photometry.radiance_w_sr_m2(1.0, spectrum("line:940"))


def test_mismatch_of_two_lines_is_the_ratio_of_responses():
    """Calibrated at 500 nm where the response is 1, read at 600 nm where it is 2: halve the reading."""
    response = np.array([500.0, 600.0]), np.array([1.0, 2.0])
    lines = (spectrum("line:600"), spectrum("line:500"))
    assert photometry.spectral_mismatch_factor(*lines, *response) == pytest.approx(0.5)


@pytest.fixture
def colour_science():
    """Return the package that the tables come from; it warns of optional parts when imported."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    return colour


def test_tables_equal_the_library_they_come_from(colour_science):
    """V(λ) as packed equals that of colour-science."""
    theirs = colour_science.SDS_LEFS["CIE 1924 Photopic Standard Observer"].values
    _, columns = table("luminous_efficiency.csv")
    np.testing.assert_allclose(columns["photopic_cie1924"], theirs, rtol=1e-6)


@pytest.mark.parametrize(("ours", "illuminant"), [("cie_d65", "D65"), ("planck:2856", "A"), ("white_led", "LED-B3")])
def test_efficacies_are_those_of_the_library(colour_science, ours, illuminant):
    """CIE illuminants over 380–780 nm, to the difference between two rules of integration."""
    lamp = colour_science.SDS_ILLUMINANTS[illuminant].copy().align(colour_science.SpectralShape(380, 780, 1))
    theirs = colour_science.luminous_efficacy(lamp)
    assert photometry.luminous_efficacy_lm_per_w(spectrum(ours)) == pytest.approx(theirs, rel=3e-3)


def _table(*points):
    return tuple(np.array(column, dtype=float) for column in zip(*points, strict=True))


@pytest.mark.parametrize(
    ("power", "weighting", "expected"),
    [
        (((400, 0), (500, 1)), ((400, 1), (500, 0)), 100.0 / 6.0),  # x·(1 − x)
        (((400, 0), (500, 1)), ((400, 0), (500, 1)), 100.0 / 3.0),  # x²
        (((400, 0), (500, 1)), ((400, 0), (450, 1), (500, 0)), 25.0),  # x times a triangle about the middle
        (
            ((400, 0), (430, 3), (460, 0)),
            ((415, 0), (445, 1)),
            33.75,
        ),  # no point in common: ∫(1.5 + x/10)·x/30 + ∫(3 − x/10)·(x + 15)/30 over 15 each
        (((400, 2), (500, 2)), ((450, 3), (460, 3)), 60.0),  # the weighting ends within the band
        (((450, 2), (460, 2)), ((400, 3), (500, 3)), 60.0),
        (((400, 2), (500, 2)), ((500, 1), (600, 1)), 0.0),
        (((400, 2), (500, 2)), ((510, 1), (600, 1)), 0.0),
    ],
)
def test_integrals_of_coarse_tables_are_those_of_their_straight_lines(power, weighting, expected):
    """Closed forms of products of straight lines; a weighting is 0 beyond its table."""
    assert Spectrum("x", *_table(*power)).integral(*_table(*weighting)) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_a_coarse_table_integrates_as_its_fine_copy():
    """A table every 50 nm and V(λ) every 50: as both on a grid of 0.05 nm, where any rule is right to 1e-6."""
    rng = np.random.default_rng(4)
    nm, power, weight = np.arange(380.0, 781.0, 50.0), rng.uniform(0.0, 1.0, 9), rng.uniform(0.0, 1.0, 9)
    fine = np.linspace(380.0, 780.0, 8001)
    product = np.interp(fine, nm, power) * np.interp(fine, nm, weight)
    assert Spectrum("x", nm, power).integral(nm, weight) == pytest.approx(np.trapezoid(product, fine), rel=1e-6)


def test_a_line_is_not_a_band():
    """Its integral is its power, whatever is next to it."""
    assert Spectrum("x", np.array([550.0]), np.array([2.0])).integral() == 2.0


@pytest.mark.parametrize(("name", "visible"), [("line:555", True), ("line:780", True), ("line:850", False)])
def test_what_has_a_luminance_is_reported(name, visible):
    """The red end is seen a little; 850 nm is not."""
    assert photometry.holds_visible_light(spectrum(name)) is visible


@pytest.mark.parametrize("kelvin", [1000.0, 2856.0, 6500.0, 50_000.0])
def test_a_black_body_has_planck_s_law(kelvin):
    """Power per nm goes as λ⁻⁵/(exp(c₂/λT) − 1) with c₂ = 14.387769 mm·K, by hand, from Wien's end to Rayleigh's."""
    body = spectrum(f"planck:{kelvin:g}")
    c2_nm_k = 1.438776877e7
    at = np.interp([400.0, 550.0, 700.0], body.wavelength_nm, body.power)
    by_hand = [nm**-5.0 / (math.exp(c2_nm_k / (nm * kelvin)) - 1.0) for nm in (400.0, 550.0, 700.0)]
    assert at / at[1] == pytest.approx(np.array(by_hand) / by_hand[1], rel=1e-8)
