"""Observers, efficacies and meters by the standards' own numbers, and units there and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.analysis.calibration import calibrate
from radiometer.analysis.calibration.calibrate import MeterSettings, scale_from_meter, scale_from_radiance
from radiometer.analysis.photometry import photometry
from radiometer.analysis.photometry.photometry import LINES, Spectrum, primary_spectrum, spectrum
from radiometer.errors import InputError
from testing.golden import cie

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
        with pytest.raises(InputError, match="above 0"):
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
def test_irradiance_and_radiance_are_inverse(radiance, angle, exposure_s, diameter):
    """E = L·π/4·(d/f)²·cos⁴α, and back from H = E·t."""
    focal = 0.05
    irradiance = calibrate.sensor_irradiance_w_m2(radiance, diameter, focal, angle)
    assert irradiance == pytest.approx(radiance * math.pi / 4 * (diameter / focal) ** 2 * math.cos(angle) ** 4)
    back = calibrate.radiance_of_exposure_w_sr_m2(irradiance * exposure_s, exposure_s, diameter, focal, angle)
    assert back == pytest.approx(radiance)
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
