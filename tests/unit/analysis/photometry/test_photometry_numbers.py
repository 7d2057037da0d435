"""Photometric quantities against standards, a peer and hand calculations."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.calibration import calibrate
from radiometer.analysis.calibration.calibrate import MeterSettings, scale_from_meter, scale_from_radiance
from radiometer.analysis.photometry import photometry
from radiometer.analysis.photometry.photometry import LINES, Spectrum, primary_spectrum, spectrum, table
from radiometer.errors import InputError
from testing.golden import cie, thesis

NAMES = ["equal_energy", "planck:2856", "cie_d65", "white_led", "display_red", "line:600", "line:450"]

positive = st.floats(1e-3, 1e3)


@pytest.mark.parametrize("nm", cie.OBSERVERS)
def test_the_observers_are_the_published_tables(nm):
    """V and V′ at each wavelength; a line of that wavelength has K·V and K′·V′."""
    v, v_dark = cie.OBSERVERS[nm]
    line = spectrum(f"line:{nm}")
    wavelength, photopic = photometry.luminous_efficiency("photopic")
    _, scotopic = photometry.luminous_efficiency("scotopic")
    assert np.interp(nm, wavelength, photopic) == pytest.approx(v, rel=1e-6)
    assert np.interp(nm, wavelength, scotopic) == pytest.approx(v_dark, rel=1e-6)
    assert photometry.luminous_efficacy_lm_per_w(line) == pytest.approx(cie.KM_LM_PER_W * v, rel=1e-6)
    found = photometry.luminous_efficacy_lm_per_w(line, "scotopic")
    assert found == pytest.approx(cie.KM_SCOTOPIC_LM_PER_W * v_dark, rel=1e-6)


@pytest.mark.parametrize("observer", ["photopic", "scotopic"])
def test_every_observer_has_the_candela_s_efficacy_at_540_thz(observer):
    """The SI's definition: 683 lm/W at 540 THz (555.016 nm in air), by day and by night; so K′_m is 683/V′ there."""
    found = photometry.luminous_efficacy_lm_per_w(spectrum("line:555.016"), observer)
    assert found == pytest.approx(683.0, abs=0.02)


@given(st.sampled_from(NAMES), st.sampled_from(["photopic", "scotopic"]), positive)
def test_units_there_and_back(name, observer, radiance):
    """W·sr⁻¹·m⁻² to cd·m⁻² and back; by a sum over wavelengths too."""
    source = spectrum(name)
    luminance = photometry.luminance_cd_m2(radiance, source, observer)
    assert photometry.radiance_w_sr_m2(luminance, source, observer) == pytest.approx(radiance)
    if source.wavelength_nm.size > 2:
        grid = np.arange(380.0, 780.5, 0.5)
        power = np.interp(grid, source.wavelength_nm, source.power)
        efficiency = np.interp(grid, *photometry.luminous_efficiency(observer))
        constant = {"photopic": cie.KM_LM_PER_W, "scotopic": cie.KM_SCOTOPIC_LM_PER_W}[observer]
        expected = constant * (power * efficiency).sum() / power.sum()
        assert luminance / radiance == pytest.approx(expected, rel=3e-3)


@given(st.floats(2.0, 8.0), positive)
def test_trolands_are_luminance_times_pupil_in_square_millimetres(diameter, luminance):
    """π·d²/4."""
    assert photometry.retinal_illuminance_td(luminance, diameter) == pytest.approx(
        luminance * math.pi * diameter**2 / 4
    )


@pytest.mark.parametrize(("pupil", "taken"), [(0.99, False), (1.0, True), (10.0, True), (10.1, False)])
def test_pupils_of_eyes(pupil, taken):
    """1 to 10 mm."""
    if taken:
        assert photometry.retinal_illuminance_td(1.0, pupil) > 0.0
    else:
        with pytest.raises(InputError, match="1 to 10 mm"):
            photometry.retinal_illuminance_td(1.0, pupil)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.1, 1.0), min_size=4, max_size=4), st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_the_mismatch_factor_takes_a_reading_to_the_truth(power, blue, red):
    """A camera of any response, calibrated under D65, reads another light right after the factor."""
    nodes, wavelength = (400.0, 500.0, 600.0, 700.0), np.arange(400.0, 701.0, 2.0)
    response = np.interp(wavelength, nodes, [0.0, blue, red, 0.0])
    source, reference = Spectrum("x", wavelength, np.interp(wavelength, nodes, power)), spectrum("cie_d65")
    grid = np.arange(380.0, 780.1, 0.25)
    seen = np.interp(grid, wavelength, response, left=0.0, right=0.0)

    def read(light, weight):
        inside = (grid >= light.band_nm[0]) & (grid <= light.band_nm[1])
        return float((np.interp(grid, light.wavelength_nm, light.power) * weight)[inside].sum())

    for observer in (None, "photopic", "scotopic"):
        eye = np.ones_like(grid) if observer is None else np.interp(grid, *photometry.luminous_efficiency(observer))
        expected = read(source, eye) / read(source, seen) * read(reference, seen) / read(reference, eye)
        found = photometry.spectral_mismatch_factor(source, reference, wavelength, response, observer)
        assert found == pytest.approx(expected, rel=6e-3)


@given(positive, st.floats(1e-4, 10.0), st.floats(1.0, 32.0), st.floats(25.0, 6400.0))
def test_a_meter_s_constant_and_luminance_are_inverse(luminance, exposure_s, f_number, iso):
    """K = L·t·S/N², and each power of it: twice the time, the speed or the aperture's area is half the luminance."""
    setting = MeterSettings(exposure_s, f_number, iso)
    constant = calibrate.meter_constant(luminance, setting)
    assert calibrate.metered_luminance_cd_m2(constant, setting) == pytest.approx(luminance)
    for other, factor in (
        (MeterSettings(2 * exposure_s, f_number, iso), 0.5),
        (MeterSettings(exposure_s, f_number, 2 * iso), 0.5),
        (MeterSettings(exposure_s, 2 * f_number, iso), 4.0),
    ):
        assert calibrate.metered_luminance_cd_m2(constant, other) == pytest.approx(factor * luminance)


@given(st.floats(400.0, 700.0), st.floats(5.0, 60.0))
def test_a_band_has_its_width_at_half_maximum(peak, width):
    """Half on either side at half the width, from one set of its wavelengths."""
    band = spectrum(f"band:{peak},{width}")
    found = np.interp([peak - width / 2, peak, peak + width / 2], band.wavelength_nm, band.power)
    assert found == pytest.approx([0.5, 1.0, 0.5], abs=2e-3)


def test_what_iso_2720_leaves_open():
    """A rectangle from 10.6 to 13.4 about 12: 6.74 %; with the meter's sixth of a stop 9.5 %."""
    low, high = cie.ISO_2720_K
    assert pytest.approx((high - low) / (high + low) / math.sqrt(3)) == calibrate.K_UNKNOWN_U_REL
    assert calibrate.metered_u_rel(None) == pytest.approx(math.hypot(math.log(2) / 6 / math.sqrt(3), 0.06736), rel=1e-3)
    assert calibrate.metered_u_rel(0.03) == pytest.approx(math.hypot(math.log(2) / 6 / math.sqrt(3), 0.03))


@given(positive, st.floats(0.001, 0.2), st.floats(0.0, 0.1), positive)
def test_a_scale_by_a_meter(meter_k, u_of_k, u_signal, signal):
    """H = L·(lens factor)·t over the signal, L = N²K/(tS)/efficacy; u of meter, K and curve in squares, and named."""
    setting = MeterSettings(1 / 60, 5.6, 100.0)
    green = spectrum("line:555")
    found = scale_from_meter(meter_k, setting, signal, green, 0.02, k_u_rel=u_of_k, signal_u_rel=u_signal)
    luminance = 5.6**2 * meter_k * 60 / 100
    assert found.value == pytest.approx(luminance / 683.0 * 0.02 / 60 / signal, rel=1e-6)
    parts = (math.log(2) / 6 / math.sqrt(3), u_of_k, u_signal)
    assert found.u_rel == pytest.approx(math.sqrt(sum(u**2 for u in parts)))
    assert sorted(found.budget.values()) == pytest.approx(sorted(parts))
    assert (found.quantity, found.f_number, found.method) == ("luminance", 5.6, "light_meter_k")
    unknown = scale_from_meter(meter_k, setting, signal, green, 0.02)
    assert unknown.budget["constant K"] == pytest.approx(0.06736, rel=1e-3)


@given(positive, st.floats(0.0, 0.1), positive, st.floats(0.0, 0.1))
def test_a_scale_by_a_known_source(radiance, u_source, rate, u_rate):
    """Radiance over reading; u of both in squares, each named."""
    found = scale_from_radiance(radiance, u_source, rate, u_rate, 4.0)
    assert found.value == pytest.approx(radiance / rate)
    assert found.u_rel == pytest.approx(math.hypot(u_source, u_rate))
    assert found.budget == {"reference source": u_source, "reading": u_rate}
    lines = {"noise": 0.3, "dark": 0.4}
    assert scale_from_radiance(radiance, 0.1, rate, 0.5, None, reading_budget=lines).budget == {
        "reference source": 0.1, **lines,
    }  # fmt: skip
    for wrong in ((-1.0, rate), (radiance, 0.0), (math.nan, rate), (radiance, math.inf)):
        with pytest.raises(InputError, match=r"above 0|is outside"):
            scale_from_radiance(wrong[0], 0.1, wrong[1], 0.1, 4.0)


@pytest.mark.parametrize("wrong", range(5))
def test_a_meter_s_figures_must_be_above_nought(wrong):
    """K, time, f-number, speed and signal."""
    figures = [16.5, 1 / 60, 5.6, 100.0, 10.0]
    figures[wrong] = 0.0
    with pytest.raises(InputError, match="above 0"):
        scale_from_meter(
            figures[0], MeterSettings(*figures[1:4]), figures[4], spectrum("line:555"), 0.02
        )  # fmt: skip


@given(positive, st.floats(0.0, 1.2), st.floats(1e-3, 1.0), st.floats(1e-3, 0.1))
def test_irradiance_of_a_radiance(radiance, angle, exposure_s, diameter):
    """E = L·π/4·(d/f)²·cos⁴α; behind a meter's f-number H = E·t."""
    focal = 0.05
    irradiance = calibrate.sensor_irradiance_w_m2(radiance, diameter, focal, angle)
    assert irradiance == pytest.approx(radiance * math.pi / 4 * (diameter / focal) ** 2 * math.cos(angle) ** 4)
    setting = MeterSettings(exposure_s, focal / diameter, 100.0)
    exposure = calibrate.reference_exposure_j_m2(radiance, setting)
    assert exposure == pytest.approx(radiance * math.pi / 4 * (diameter / focal) ** 2 * exposure_s)
    assert calibrate.reference_exposure_j_m2(radiance, setting, 0.5) == pytest.approx(radiance * 0.5 * exposure_s)


@pytest.mark.parametrize(("ours", "of_the_calibration"), [("line:600", "line:500"), ("line:500", "line:600")])
def test_light_that_the_camera_cannot_see_has_no_correction(ours, of_the_calibration):
    """Neither a source nor a calibration at 500 nm, where the response is zero, gives a factor."""
    wavelength, response = np.array([550.0, 560.0, 700.0]), np.array([0.0, 1.0, 1.0])
    with pytest.raises(InputError, match="response is zero"):
        photometry.spectral_mismatch_factor(spectrum(ours), spectrum(of_the_calibration), wavelength, response)


@pytest.mark.parametrize("colour", ["red", "green", "blue"])
@pytest.mark.parametrize("kind", sorted(LINES))
def test_a_primary_s_lines_have_their_shares_and_widths(kind, colour):
    """Mean wavelength and spread of the whole are those of Gaussian lines of the stated peaks, widths and shares."""
    wavelength, power = primary_spectrum(kind, colour)
    peaks, widths, shares = (np.array(part) for part in zip(*LINES[kind][colour], strict=True))
    shares = shares / shares.sum()
    mean = shares @ peaks
    variance = shares @ ((widths / math.sqrt(8 * math.log(2))) ** 2 + (peaks - mean) ** 2)
    power = power / power.sum()
    assert power @ wavelength == pytest.approx(mean, abs=1.5)
    assert math.sqrt(power @ (wavelength - mean) ** 2) == pytest.approx(math.sqrt(variance), rel=0.05)


@pytest.mark.parametrize("colour", ["red", "green", "blue"])
@pytest.mark.parametrize("kind", sorted(LINES))
def test_a_primary_s_shares_are_those_of_one_whole(kind, colour):
    """All that it sends is 1, and its strongest line peaks where it is stated, odd wavelengths too."""
    wavelength, power = primary_spectrum(kind, colour)
    assert power.sum() == pytest.approx(1.0, rel=1e-9)
    peak, width, _ = max(LINES[kind][colour], key=lambda line: line[2] / line[1])
    assert wavelength[np.argmax(power)] == pytest.approx(peak, abs=0.5 if width < 10.0 else 2.0)


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
    """17.892 W·sr⁻¹·m⁻² through f = 20 mm, d = 3.571 mm give H = 1.792e-3 J/m² in 1/250 s."""
    assert round(calibrate.sensor_irradiance_w_m2(17.892, 3.571e-3, 20e-3) / 250, 6) == 1.792e-3


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
