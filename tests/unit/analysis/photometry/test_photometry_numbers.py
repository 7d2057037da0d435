"""Photometric quantities against standards, a peer and hand calculations; light of another or unknown colour."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import radiometer as rm
from radiometer.analysis.calibration import calibrate
from radiometer.analysis.calibration.calibrate import MeterSettings, scale_from_meter, scale_from_radiance
from radiometer.analysis.photometry import photometry
from radiometer.analysis.photometry.alpha_opic import RECEPTORS, alpha_opic_quantities
from radiometer.analysis.photometry.photometry import (
    KINDS,
    LINES,
    Spectrum,
    luminous_efficacy,
    luminous_efficacy_lm_per_w,
    primary_spectrum,
    spectrum,
    spectrum_from_csv,
    table,
)
from radiometer.analysis.photometry.responses import unknown_mismatch_u_rel, unstated_light_u_rel
from radiometer.analysis.photometry.spectral_correction import spectral_factor
from radiometer.analysis.reading.budget import spectral_u_rel
from radiometer.analysis.reading.reading import read_patch
from radiometer.analysis.signal.situation import spectral_correction
from radiometer.data import BlackLevel, Patch, Quantity, SpectralResponse, StatedUncertainties
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.errors import InputError, UsageError
from testing.golden import cie, thesis
from testing.relatively import relatively

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
    assert np.interp(nm, wavelength, scotopic) == pytest.approx(v_dark, rel=1e-6, abs=0.0)
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
    constant = luminance * exposure_s * iso / f_number**2
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


def test_the_meter_of_iso_2720_and_the_worked_example_of_the_thesis():
    """K from 10.6 to 13.4 is 6.74 %; 16.5 at f/16, 1/125 s, ISO 136."""
    low, high = cie.ISO_2720_K
    assert pytest.approx((high - low) / (high + low) / math.sqrt(3)) == calibrate.K_UNKNOWN_U_REL
    assert calibrate.metered_u_rel(None) == pytest.approx(math.hypot(math.log(2) / 6 / math.sqrt(3), 0.06736), rel=1e-3)
    assert calibrate.metered_u_rel(0.03) == pytest.approx(math.hypot(math.log(2) / 6 / math.sqrt(3), 0.03))
    found = calibrate.metered_luminance_cd_m2(thesis.MEAN_METER_CONSTANT, REFERENCE)
    assert round(found, 4) == thesis.REFERENCE_LUMINANCE
    # The printed figure is the result cut, not rounded, after the fourth decimal.
    assert math.floor(photometry.radiance_thesis_w_sr_m2_um(found) * 1e4) / 1e4 == thesis.REFERENCE_SPECTRAL_RADIANCE
    exposure = calibrate.reference_exposure_j_m2(thesis.REFERENCE_SPECTRAL_RADIANCE, REFERENCE)
    assert round(math.log(exposure), 4) == thesis.REFERENCE_LOG_EXPOSURE  # the thesis has the exponential of that
    assert f"{math.exp(round(math.log(exposure), 4)):.5e}" == f"{thesis.REFERENCE_EXPOSURE_J_M2:.5e}"


@given(positive, st.floats(0.001, 0.2), st.floats(0.0, 0.1), positive)
def test_a_scale_by_a_meter(meter_k, u_of_k, u_signal, signal):
    """H = L·(lens factor)·t over the signal, L = N²K/(tS)/efficacy; u of meter, K and curve in squares, and named."""
    setting = MeterSettings(1 / 60, 5.6, 100.0)
    green = spectrum("line:555")
    found = scale_from_meter(meter_k, setting, signal, green, 0.02, k_u_rel=u_of_k, signal_u_rel=u_signal)
    luminance = 5.6**2 * meter_k * 60 / 100
    assert found.value == relatively(luminance / 683.0 * 0.02 / 60 / signal, rel=1e-6)
    parts = (math.log(2) / 6 / math.sqrt(3), u_of_k, u_signal)
    assert found.u_rel == pytest.approx(math.sqrt(sum(u**2 for u in parts)))
    assert sorted(found.budget.values()) == pytest.approx(sorted(parts), rel=1e-6, abs=0.0)
    assert (found.quantity, found.f_number, found.method) == ("luminance", 5.6, "light_meter_k")
    unknown = scale_from_meter(meter_k, setting, signal, green, 0.02)
    assert unknown.budget["constant K"] == pytest.approx(0.06736, rel=1e-3)


@given(positive, st.floats(0.0, 0.1), positive, st.floats(0.0, 0.1))
def test_a_scale_by_a_known_source(radiance, u_source, rate, u_rate):
    """Radiance over reading; u of both in squares, each named."""
    found = scale_from_radiance(radiance, u_source, rate, u_rate, 4.0)
    assert found.value == pytest.approx(radiance / rate)
    assert found.u_rel == pytest.approx(math.hypot(u_source, u_rate), rel=1e-6, abs=0.0)
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


@given(positive, st.floats(1e-3, 1.0), st.floats(1e-3, 0.1))
def test_exposure_of_a_radiance(radiance, exposure_s, diameter):
    """H = L·π/4·(d/f)²·t behind a meter's f-number; what more is known of the lens takes its place."""
    focal = 0.05
    setting = MeterSettings(exposure_s, focal / diameter, 100.0)
    exposure = calibrate.reference_exposure_j_m2(radiance, setting)
    assert exposure == relatively(radiance * math.pi / 4 * (diameter / focal) ** 2 * exposure_s)
    assert calibrate.reference_exposure_j_m2(radiance, setting, 0.5) == relatively(radiance * 0.5 * exposure_s)


@pytest.mark.parametrize(("ours", "of_the_calibration"), [("line:600", "line:500"), ("line:500", "line:600")])
def test_light_that_the_camera_cannot_see_has_no_correction(ours, of_the_calibration):
    """Neither a source nor a calibration at 500 nm, where the response is zero, gives a factor."""
    wavelength, response = np.array([550.0, 560.0, 700.0]), np.array([0.0, 1.0, 1.0])
    with pytest.raises(InputError, match="response is zero"):
        photometry.spectral_mismatch_factor(spectrum(ours), spectrum(of_the_calibration), wavelength, response)


@pytest.mark.parametrize("colour", ["red", "green", "blue"])
@pytest.mark.parametrize("kind", sorted(LINES))
def test_a_primary_s_lines_have_their_shares_and_widths(kind, colour):
    """All that it sends is 1; mean wavelength and spread are those of Gaussian lines of the stated peaks and widths.

    Its strongest line peaks where it is stated, odd wavelengths too.
    """
    wavelength, power = primary_spectrum(kind, colour)
    peaks, widths, shares = (np.array(part) for part in zip(*LINES[kind][colour], strict=True))
    shares = shares / shares.sum()
    mean = shares @ peaks
    variance = shares @ ((widths / math.sqrt(8 * math.log(2))) ** 2 + (peaks - mean) ** 2)
    assert power.sum() == pytest.approx(1.0, rel=1e-9)
    assert power @ wavelength == pytest.approx(mean, abs=1.5)
    assert math.sqrt(power @ (wavelength - mean) ** 2) == pytest.approx(math.sqrt(variance), rel=0.05)
    highest = np.argmax(shares / widths)
    assert wavelength[np.argmax(power)] == pytest.approx(peaks[highest], abs=0.5 if widths[highest] < 10.0 else 2.0)


EXACT_K = [16.6016, 16.6016, 18.6346, 14.6417, 14.6417, 16.4347]

REFERENCE = MeterSettings(1 / 125, 16.0, thesis.MEASURED_ISO)


@pytest.mark.parametrize("is_exact", [False, True])
@pytest.mark.parametrize(("row", "exact_k"), list(zip(thesis.METER_CONSTANTS, EXACT_K, strict=True)))
def test_luminances_by_the_meter_constants_of_the_thesis(row, exact_k, is_exact):
    """Printed settings give the six luminances by the table's constants; exact stops take their rounding out.

    f/16 and f/5.6 then agree to all digits; f/1.7 stays higher by one sixth of a stop.
    """
    luminance, f_number, exposure_s, printed_k = row
    settings = MeterSettings(exposure_s, f_number, thesis.MEASURED_ISO)
    found = calibrate.metered_luminance_cd_m2(*((exact_k, settings.exact()) if is_exact else (printed_k, settings)))
    assert found == pytest.approx(luminance, rel=5e-6)


def test_the_thesis_has_the_gaussian_s_area_and_radiance_per_micrometre():
    """∫V dλ of (2.9) is 0.1068 µm; (2.10) times 0.4 µm is the band's."""
    wavelength, gaussian = photometry.luminous_efficiency("photopic_gaussian")
    assert round(float(np.trapezoid(gaussian, wavelength * 1e-3)), 4) == 0.1068
    _, tabulated = photometry.luminous_efficiency("photopic")
    assert float(tabulated.sum()) == pytest.approx(106.856917, abs=1e-5)
    right = photometry.radiance_w_sr_m2(3882.3529, spectrum("equal_energy"))
    assert right == pytest.approx(photometry.radiance_thesis_w_sr_m2_um(3882.3529) * 0.4, rel=1e-3)


@pytest.mark.parametrize(
    "name",
    [
        "moonlight",
        "planck:hot",
        "planck:499",
        "display:oled:purple",
        "band:525",
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


def test_a_line_is_no_band_and_infrared_has_no_luminance():
    """Its integral is its power; 940 nm is refused rather than divided by zero."""
    assert Spectrum("x", np.array([550.0]), np.array([2.0])).integral() == 2.0
    with pytest.raises(InputError, match="no visible light"):
        photometry.radiance_w_sr_m2(1.0, spectrum("line:940"))


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


# Correction of readings for light of another colour, and the doubt where the spectrum is unknown.


HEADER = "wavelength_nm,responsivity\n"


@pytest.mark.parametrize(
    ("line_nm", "peak_nm", "width_nm", "rel"),
    [
        (550, 453.0, 0, 1e-9),
        (640, 640.0, 0, 1e-12),
        (550, 640.0, 20, 1e-4),
        (550, 850.0, 40, 1e-4),
        (850, 550.0, 20, 1e-4),
    ],
)
def test_photon_counter_goes_as_wavelength(line_nm, peak_nm, width_nm, rel):
    """Per watt in proportion to λ, beyond the visible too; the same light needs none; a line acts as its centre."""
    assert spectral_factor(f"line:{line_nm}", peak_nm, width_nm) == pytest.approx(line_nm / peak_nm, rel=rel)


@pytest.mark.parametrize(
    "text", ["a,b\n1,2\n", "wavelength_nm,responsivity\n500,1\n600,1\n", "wavelength_nm,responsivity\n"]
)
def test_unusable_responsivity_is_named(tmp_path, text):
    """A file of another form or too short a reach is refused."""
    file = tmp_path / "camera.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=r"camera\.csv"):
        spectral_factor("line:550", 453.0, 0.0, file)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_what_a_light_reaches_is_reported_in_shares_of_its_peak(tmp_path, unit):
    """Whatever unit its spectrum is in: a tail of 1/1000 beyond the table is let pass, one of a tenth is not."""
    table, light = tmp_path / "responsivity.csv", tmp_path / "light.csv"
    table.write_text(HEADER + "400,1\n800,1\n", encoding="utf-8")
    for tail, taken in ((0.001, True), (0.1, False)):
        rows = ((500, 0.0), (600, 1.0), (700, tail), (900, tail), (901, 0.0))
        light.write_text("\n".join(f"{nm},{power * unit!r}" for nm, power in rows), encoding="utf-8")
        if taken:
            assert spectral_factor(str(light), 600.0, 0.0, table) == pytest.approx(1.0, rel=1e-3)
        else:
            with pytest.raises(InputError, match="the responsivity ends at 800 nm"):
                spectral_factor(str(light), 600.0, 0.0, table)


@pytest.mark.parametrize(("peak_nm", "share_above"), [(550.0, 0.5), (560.0, 0.880473), (530.0, 0.009257)])
def test_a_line_has_the_width_that_is_stated(tmp_path, peak_nm, share_above):
    """Of a Gaussian of 20 nm, σ = 8.493 nm, a half, Φ(1.1774) and Φ(−2.3548) lie above a step at 550 nm."""
    file = tmp_path / "camera.csv"
    file.write_text("wavelength_nm,responsivity\n380,1\n549.999,1\n550.001,3\n780,3\n")
    found = spectral_factor("line:450", peak_nm, 20.0, file)
    assert found == pytest.approx(1.0 / (1.0 + 2.0 * share_above), rel=2e-3)


ONLY_EFFICACY = StatedUncertainties(**dict.fromkeys(StatedUncertainties.model_fields, 0.0)).model_copy(
    update={"efficacy_u_rel": 0.4}
)


def reading(rig, quantity, spectra=("equal_energy", "equal_energy")):
    black = BlackLevel(dn=64.0, u_dn=0.0)
    base = rig.calibration(u_rel=0.01, uncertainties=ONLY_EFFICACY, black_level=black, spectrum=spectra[1])
    scale = base.scale.model_copy(update={"quantity": quantity, "spectrum": spectra[0]})
    scene = np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3))
    frames = rig.frames(scene, np.random.default_rng(1), (1e-3,) * 5)
    return read_patch(frames, Patch(0, 0, 12, 12), Setup(rig.description, rig.lens, replace(base, scale=scale)))


@pytest.mark.parametrize(("quantity", "other"), [("luminance", "radiance"), ("radiance", "luminance")])
def test_a_scale_from_one_quantity_doubts_the_other(rig, quantity, other):
    """The efficacy's 40 % are in the other one, and cancel in its own: there only the scale's 1 % is left."""
    found = reading(rig, quantity)
    assert getattr(found, other).u_rel == pytest.approx(math.hypot(0.01, 0.4), rel=1e-3)
    assert getattr(found, quantity).u_rel == pytest.approx(0.01, rel=0.02)
    assert quantity == "radiance" or "spectrum_assumed" in found.flags


def test_unknown_responses_doubt_another_spectrum_unless_stated(rig):
    """The figure that somebody states stands in place of all kinds."""
    found = reading(rig, "radiance", ("line:500", "line:600"))
    line = next(one.u_rel for one in found.budget if one.name == "spectral assumption")
    bells = [2.0 ** (((600 - peak) / 150) ** 2 - ((500 - peak) / 150) ** 2) / 1.2 - 1.0 for peak in (500, 550, 600)]
    assert line == pytest.approx(math.sqrt(np.mean(np.square([1.0 / 1.2 - 1.0, *bells]))), rel=1e-6)
    assert unknown_mismatch_u_rel("white_led", "white_led") == pytest.approx(0.0, abs=1e-12)
    stated = StatedUncertainties(spectral_u_rel=0.05)
    found = unstated(rig, rig.calibration(spectrum="white_led", uncertainties=stated))
    assert spectral_line(found).u_rel == pytest.approx(0.05)
    assert spectral_line(found).note.endswith("as stated")
    assert "spectrum_assumed" in found.flags
    base = rig.calibration(spectrum="white_led")
    relative = replace(base, scale=base.scale.model_copy(update={"method": "relative"}))
    assert spectral_u_rel(relative, StatedUncertainties(), spectrum_stated=False) == 0.0


@pytest.mark.parametrize(
    ("name", "label"),
    [("led_b1", "LED-B1"), ("led_rgb1", "LED-RGB1"), ("led_v2", "LED-V2"), ("cie_a", "A"), ("cie_fl11", "FL11")],
)
def test_tabulated_spectra_are_the_published_ones(name, label):
    """Luminous efficacies against the tables of `colour-science`."""
    import colour

    published = colour.SDS_ILLUMINANTS[label]
    known = {float(w): float(v) for w, v in zip(published.wavelengths, published.values, strict=True)}
    wavelength = np.arange(380.0, 781.0, 5.0)
    power = np.array([known.get(w, 0.0) for w in wavelength])
    found = spectrum(name)
    assert found.power / found.power.max() == pytest.approx(power / power.max(), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(("name", "band"), [("white_led", (380.0, 780.0)), ("line:550", (550.0, 550.0))])
def test_a_reading_states_the_band_that_its_radiance_counts(rig, name, band):
    """That of the spectrum that the scale holds for, in JSON too."""
    found = reading(rig, "radiance", (name, name))
    assert found.band_nm == band
    assert found.to_mapping()["band_nm"] == list(band)


@pytest.mark.parametrize(("source", "u_rel"), [("line:600", 0.03), ("line:500.1", None)])
def test_a_known_response_costs_no_more_than_an_unknown_one(rig, source, u_rel):
    """Its own u far from the calibration's spectrum; next to it, where every plausible camera agrees, less."""
    response = SpectralResponse(wavelength_nm=(300.0, 1100.0), relative=(300.0, 1100.0), u_rel=0.03, source="a test")
    base = replace(rig.calibration(spectrum=source), spectral_response=response)
    of_500 = replace(base, scale=base.scale.model_copy(update={"spectrum": "line:500"}))
    expected = unknown_mismatch_u_rel(source, "line:500") if u_rel is None else u_rel
    assert spectral_u_rel(of_500, ONLY_EFFICACY.model_copy(update={"efficacy_u_rel": 0.0})) == pytest.approx(expected)
    assert spectral_correction(of_500)[1][0].endswith("applied, by the a test")


def unstated(rig, calibration, *, spectrum_stated=False):
    scene = np.full((12, 12), 0.5 * rig.radiance_of_full_scale(1e-3))
    frames = rig.frames(scene, np.random.default_rng(1), (1e-3,) * 5)
    patch = Patch(0, 0, 12, 12)
    return read_patch(
        frames,
        patch,
        Setup(rig.description, rig.lens, calibration, spectrum=AS_CALIBRATED if spectrum_stated else None),
    )


FLAT = SpectralResponse(wavelength_nm=(300.0, 1100.0), relative=(1.0, 1.0), u_rel=0.03)


def spectral_line(found):
    return next(one for one in found.budget if one.name == "spectral assumption")


def test_light_of_unknown_spectrum_may_be_of_any_kind(rig):
    """White LED assumed, camera unknown: 20 % for the radiance, 36 % for the luminance; the budget says from what."""
    base = rig.calibration(spectrum="white_led", u_rel=0.0, uncertainties=StatedUncertainties())
    found, known = unstated(rig, base), unstated(rig, base, spectrum_stated=True)
    assert (
        spectral_line(found).u_rel
        == pytest.approx(unstated_light_u_rel("white_led", None))
        == pytest.approx(0.199, abs=1e-3)
    )
    assert "spread of white LEDs, incandescent lamps, daylight" in spectral_line(found).note
    assert "spectrum_assumed" in found.flags
    assert found.radiance.value == known.radiance.value
    assert found.radiance.u_rel == pytest.approx(math.hypot(known.radiance.u_rel, 0.199), rel=4e-3)
    assert found.luminance.u_rel == pytest.approx(math.hypot(known.radiance.u_rel, 0.358), rel=4e-3)
    assert spectral_line(known).u_rel == 0.0
    assert "spectrum_assumed" not in known.flags


def test_unknown_light_is_doubted_by_what_the_camera_counts():
    """A flat response leaves the radiance alone; one that ends before the light says nothing."""
    assert unstated_light_u_rel("white_led", FLAT) == pytest.approx(0.03)
    efficacy = {name: luminous_efficacy_lm_per_w(spectrum(name)) for names in KINDS.values() for name in names}
    off = [[(efficacy[one] / efficacy["white_led"] - 1.0) ** 2 for one in names] for names in KINDS.values()]
    expected = math.hypot(math.sqrt(np.mean([np.mean(kind) for kind in off])), 0.03)
    assert unstated_light_u_rel("white_led", FLAT, "photopic") == pytest.approx(expected, rel=1e-3)
    short = SpectralResponse(wavelength_nm=(300.0, 400.0), relative=(1.0, 1.0))
    assert unstated_light_u_rel("line:600", short) == unstated_light_u_rel("line:600", None)


# What the table of a light, or of a receptor, does not state is in the uncertainty, or refused.


FINE_NM = np.arange(200.0, 1100.1, 0.25)


def bands(rng):
    """Return the power of some coloured lights over the fine grid."""
    power = np.zeros_like(FINE_NM)
    for peak, width in zip(rng.uniform(450.0, 650.0, 3), rng.uniform(15.0, 80.0, 3), strict=True):
        power += rng.uniform(0.1, 1.0) * 0.5 ** (4.0 * ((FINE_NM - peak) / width) ** 2)
    return np.where(power < 1e-9, 0.0, power)


def figures(light):
    """Return the luminous efficacy and the α-opic quantities of a luminance."""
    made = alpha_opic_quantities(Quantity(100.0, 0.0, "cd m-2"), light)
    return [luminous_efficacy(light), *(one.quantity for one in made)]


def as_csv(path, nm, power):
    """Return the light as a file of it is read."""
    np.savetxt(path, np.column_stack([nm, power]), "%.9g", ",", header="wavelength_nm,power", comments="")
    return spectrum_from_csv(path)


@cache
def random_lights():
    """Return forty lights, the part of a step by which a table of each begins earlier, and its figures."""
    rng = np.random.default_rng(48_001)
    drawn = [(bands(rng), rng.uniform()) for _ in range(40)]
    return [(power, part, figures(Spectrum("true", FINE_NM, power))) for power, part in drawn]


@pytest.mark.parametrize("step_nm", [5, 20, 100])
def test_a_light_in_coarse_steps_is_right_within_u_or_refused(tmp_path, step_nm):
    """Over random lights and first wavelengths; steps of 5 nm and less are never refused, of 100 nm always."""
    taken, right = 0, 0
    for n, (power, part, true) in enumerate(random_lights()):
        nm = np.arange(300.0 - part * step_nm, 900.0, step_nm)
        try:
            found = figures(as_csv(tmp_path / f"{n}.csv", nm, np.interp(nm, FINE_NM, power)))
        except InputError:
            continue
        taken += 1
        tolerance = 1e-6 * max(one.value for one in true[1:])
        right += all(abs(a.value - b.value) <= 2.0 * a.u + tolerance for a, b in zip(found, true, strict=True))
    assert right >= 0.9 * taken
    assert taken == 40 or step_nm > 5
    assert taken == 0 or step_nm < 100


@pytest.mark.parametrize("part", [1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("peak_nm", [450.0, 550.0, 620.0])
def test_a_light_that_is_cut_off_is_right_within_u_or_refused(tmp_path, part, peak_nm):
    """Where the table ends at some part of the peak: whatever was cut off is covered."""
    power = np.round(0.5 ** (4.0 * ((FINE_NM - peak_nm) / 60.0) ** 2), 9)
    true = figures(Spectrum("true", FINE_NM, power))
    kept = (peak_nm > FINE_NM) | (power > part)
    try:
        found = figures(as_csv(tmp_path / "cut.csv", FINE_NM[kept], power[kept]))
    except InputError:
        assert part >= 0.01
        return
    assert part < 0.9
    for one, other in zip(found[1:], true[1:], strict=True):  # an efficacy is of the band that a table states
        assert abs(one.value - other.value) <= 2.0 * one.u + 1e-6 * other.value


@pytest.mark.parametrize("name", ["band:370,10", "band:375,12", "band:380,10", "band:790,10", "band:800,30"])
def test_light_beyond_the_tables_is_not_none(name):
    """Each receptor may answer to light that its table does not reach as it does at the end: u holds that."""
    for one in rm.alpha_opic(100.0, spectrum=name).quantities:
        assert one.quantity.u > 0.1 * one.quantity.value
    inside = rm.alpha_opic(100.0, spectrum="band:550,20").quantities
    assert [one.quantity.u for one in inside] == pytest.approx([0.0] * 5, abs=1e-9)


def test_a_reading_of_too_little_known_light_has_no_luminance(tmp_path):
    """A light that is stated to 495 nm alone has a radiance; a map or a value of it has no luminance either."""
    nm = np.arange(380.0, 496.0, 5.0)
    light = as_csv(tmp_path / "part.csv", nm, 0.5 ** (4.0 * ((nm - 480.0) / 30.0) ** 2))
    with pytest.raises(InputError, match="leaves its luminance unknown"):
        luminous_efficacy(light)
    with pytest.raises(InputError, match="leaves its luminance unknown"):
        rm.alpha_opic(1.0, "W/m2", spectrum=str(tmp_path / "part.csv"))


# α-opic quantities compared with the figures of CIE S 026 and with calculations by hand.


# α-opic efficacies of luminous radiation of daylight D65 in mW/lm. Source: CIE S 026:2018, table 3.
DAYLIGHT = {
    "s_cone_opic": 0.8173,
    "m_cone_opic": 1.4558,
    "l_cone_opic": 1.6289,
    "rhodopic": 1.4497,
    "melanopic": 1.3262,
}


@pytest.mark.parametrize("receptor", RECEPTORS)
def test_daylight_is_its_own_equivalent_and_has_the_efficacy_of_the_standard(receptor):
    """Daylight is its own equivalent and has the efficacy of the standard."""
    one = rm.alpha_opic(250.0, "lx", spectrum="cie_d65")[receptor]
    assert one.efficacy_mw_lm.value == pytest.approx(DAYLIGHT[receptor], abs=5e-5)
    assert one.quantity.value == pytest.approx(0.25 * DAYLIGHT[receptor], rel=1e-4)
    assert (one.equivalent_daylight.value, one.daylight_ratio.value) == (pytest.approx(250.0), pytest.approx(1.0))
    assert (one.quantity.unit, one.equivalent_daylight.unit) == ("W m-2", "lx")


# α-opic efficacies in mW/lm, in the order of RECEPTORS. Source: luxpy 1.12.5, spd_to_aopicELR, of the same tables.
@pytest.mark.parametrize(
    ("name", "efficacies"),
    [
        ("cie_a", (0.25419, 1.1742, 1.6567, 0.83077, 0.65751)),
        ("white_led", (0.50479, 1.2871, 1.6253, 1.0127, 0.83892)),
        ("led_v1", (0.26825, 1.1615, 1.6690, 0.82747, 0.65797)),
        ("cie_fl11", (0.48328, 1.2664, 1.6143, 0.93929, 0.74745)),
        ("equal_energy", (0.75640, 1.3968, 1.6389, 1.3301, 1.2013)),
    ],
)
def test_the_efficacies_of_common_lights_are_those_of_a_peer(name, efficacies):
    """The efficacies of common lights are those of a peer."""
    found = rm.alpha_opic(1.0, spectrum=name)
    assert [one.efficacy_mw_lm.value for one in found.quantities] == pytest.approx(efficacies, rel=3e-4)


def test_a_line_excites_by_its_action_spectrum():
    """A line excites by its action spectrum; its u is the slope at the line by the wavelength's u."""
    wavelength, columns = table("alpha_opic.csv")
    at_490 = columns["melanopic"][wavelength == 490.0][0]
    found = rm.alpha_opic(3.0, "W/m2", spectrum="line:490")["melanopic"]
    assert found.quantity.value == pytest.approx(3.0 * at_490)
    assert at_490 == pytest.approx(1.0, abs=1e-3)  # its peak is at 490 nm
    sloping = rm.alpha_opic(3.0, "W/m2", spectrum="line:520", wavelength_u_nm=2.0)["melanopic"].quantity
    ends = np.interp([518.0, 522.0], wavelength, columns["melanopic"])
    assert sloping.u == pytest.approx(3.0 * (ends[0] - ends[1]) / 2.0)
    for receptor, column in columns.items():
        last = np.flatnonzero(column)[-1]
        found = rm.alpha_opic(1.0, "W/m2", spectrum=f"line:{wavelength[last]:g}")[receptor]
        assert found.quantity.value == pytest.approx(column[last], rel=1e-6, abs=0.0), receptor


def test_radiance_and_luminance_of_one_light_give_the_same():
    """Radiance and luminance of one light give the same."""
    from radiometer.analysis.photometry.photometry import luminance_cd_m2

    watts, candela = (
        rm.alpha_opic(0.3, "W/sr/m2", u=0.003, spectrum="white_led"),
        rm.alpha_opic(luminance_cd_m2(0.3, spectrum("white_led")), "cd/m2", spectrum="white_led"),
    )
    for receptor in RECEPTORS:
        assert watts[receptor].quantity.value == pytest.approx(candela[receptor].quantity.value, rel=1e-9)
        assert watts[receptor].quantity.u / watts[receptor].quantity.value == pytest.approx(0.01)


@pytest.mark.parametrize("unit", ["cd m-2", "W sr-1 m-2"])
def test_the_uncertainty_of_the_spectrum_is_that_of_drawn_spectra(unit):
    """The uncertainty of the spectrum is that of drawn spectra."""
    light, rng = spectrum("white_led"), np.random.default_rng(46_002)
    stated = alpha_opic_quantities(Quantity(100.0, 0.0, unit), light, 0.05, 0.8)
    drawn = []
    for _ in range(100):
        power = light.power * (1.0 + 0.05 * rng.standard_normal(light.power.size))
        moved = Spectrum("drawn", light.wavelength_nm + 0.8 * rng.standard_normal(), np.maximum(power, 0.0))
        drawn.append([one.quantity.value for one in alpha_opic_quantities(Quantity(100.0, 0.0, unit), moved)])
    for one, spread in zip(stated, np.std(drawn, axis=0), strict=True):
        assert one.quantity.u == pytest.approx(spread, rel=0.25)  # of 100 draws: 7 %, k = 3.5


def test_a_level_of_a_screen_and_a_reading_are_sources(tmp_path):
    """A level of a screen and a reading are sources."""
    screen = rm.screen_calibrate(display="lcd", quick=True).calibration
    luminance = screen.channel("grey").at(200, "cd m-2")
    of_level = rm.alpha_opic(screen=screen, level=200)
    assert of_level.source == luminance
    (tmp_path / "reading.json").write_text(json.dumps({"radiance": None, "luminance": luminance.to_mapping()}))
    of_file = rm.alpha_opic(reading=tmp_path / "reading.json", spectrum=screen.channel("grey").spectrum)
    assert of_file["rhodopic"] == of_level["rhodopic"]


def test_a_source_of_known_size_and_distance_gives_the_illuminance_at_the_eye():
    """Small: L·A/d². A disc of 45° half angle: half of πL. A wide wall: πL. A rectangle: the sum of its parts."""
    small = rm.alpha_opic(100.0, u=1.0, spectrum="cie_d65", size_m=(0.02, 0.01), distance_m=2.0, u_distance_m=0.02)
    assert small.source.value == pytest.approx(100.0 * 2e-4 / 4.0, rel=1e-4)
    assert small.source.u / small.source.value == pytest.approx(np.hypot(0.01, 2 * 0.02 / 2.0), rel=1e-3)
    assert (small.source.unit, small["melanopic"].equivalent_daylight.unit) == ("lx", "lx")
    disc = rm.alpha_opic(1.0, "W/sr/m2", spectrum="cie_a", size_m=[2.0], distance_m=1.0)
    assert (disc.source.value, disc.source.unit) == (pytest.approx(np.pi / 2), "W m-2")
    assert rm.alpha_opic(1.0, spectrum="cie_a", size_m=(1e5, 1e5), distance_m=1.0).source.value == pytest.approx(np.pi)
    x, y = np.meshgrid(*((np.arange(500) + 0.5) / 500 * side - side / 2 for side in (0.52, 0.32)))
    summed = np.sum(0.6**2 / (x**2 + y**2 + 0.6**2) ** 2) * 0.52 * 0.32 / 500**2  # cos⁴θ/d² of each part
    found = rm.alpha_opic(1.0, spectrum="cie_a", size_m=(0.52, 0.32), distance_m=0.6)
    assert found.source.value == pytest.approx(summed, rel=1e-5)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({}, UsageError),
        ({"value": 1.0}, UsageError),
        ({"value": 1.0, "reading": "x.json", "spectrum": "cie_a"}, UsageError),
        ({"value": 1.0, "level": 3, "spectrum": "cie_a"}, UsageError),
        ({"value": 1.0, "unit": "fc", "spectrum": "cie_a"}, UsageError),
        ({"value": 1.0, "wavelength_u_nm": 1.0}, UsageError),
        ({"value": 1.0, "spectrum": "cie_a", "wavelength_u_nm": 500.0}, UsageError),
        ({"value": 1.0, "spectrum": "cie_a", "size_m": (1.0,), "distance_m": 1e-300}, UsageError),
        ({"value": 1.0, "spectrum": "line:1064"}, InputError),
        ({"value": -1.0, "spectrum": "cie_a"}, UsageError),
        ({"value": float("nan"), "spectrum": "cie_a"}, UsageError),
        ({"reading": "missing.json", "spectrum": "cie_a"}, InputError),
        ({"value": 1.0, "spectrum": "cie_a", "size_m": (0.1,)}, UsageError),
        ({"value": 1.0, "spectrum": "cie_a", "size_m": (0.1, 0.0), "distance_m": 1.0}, UsageError),
        ({"value": 1.0, "unit": "lx", "spectrum": "cie_a", "size_m": (0.1,), "distance_m": 1.0}, UsageError),
    ],
)
def test_what_gives_no_quantity_is_refused(given, error):
    """What gives no quantity is refused."""
    with pytest.raises(error):
        rm.alpha_opic(**given)  # type: ignore[arg-type]


def test_a_reading_counts_for_the_spectrum_that_it_was_made_for(tmp_path):
    """Its luminance is that of such light; its flags go on, and a relative reading has no such quantities."""
    stated = {
        "radiance": {"value": 1.5, "u": 0.01, "unit": "W sr-1 m-2"},
        "luminance": {"value": 475.0, "u": 5.0, "unit": "cd m-2"},
        "flags": ["saturated"], "assumptions": ["spectrum white_led"],
    }  # fmt: skip
    file = tmp_path / "r.json"
    file.write_text(json.dumps(stated))
    with pytest.raises(UsageError, match="measure again with --spectrum line:465"):
        rm.alpha_opic(reading=file, spectrum="line:465")
    found = rm.alpha_opic(reading=file, spectrum="white_led")
    assert "the reading is flagged saturated" in found.assumptions
    for change in ({"flags": ["uncalibrated"]}, {"radiance": {"value": 1.5, "u": 0.01, "unit": "relative"}}):
        file.write_text(json.dumps({**stated, **change}))
        with pytest.raises(UsageError, match="relative"):
            rm.alpha_opic(reading=file, spectrum="white_led")
