"""Correction of readings for light of another colour, and the doubt where the spectrum is unknown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.photometry.photometry import KINDS, luminous_efficacy_lm_per_w, spectrum, unstated_light_u_rel
from radiometer.analysis.photometry.spectral_correction import spectral_factor
from radiometer.analysis.reading.budget import spectral_u_rel, unknown_mismatch_u_rel
from radiometer.analysis.reading.reading import read_patch
from radiometer.analysis.signal.situation import spectral_correction
from radiometer.data import BlackLevel, Patch, SpectralResponse, StatedUncertainties
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.errors import InputError

HEADER = "wavelength_nm,responsivity\n"


@pytest.mark.parametrize(
    ("line_nm", "peak_nm", "width_nm", "rel"),
    [(550, 453.0, 0.0, 1e-9), (640, 640.0, 0.0, 1e-12), (550, 640.0, 20.0, 1e-4)],
)
def test_photon_counter_goes_as_wavelength(line_nm, peak_nm, width_nm, rel):
    """Per watt in proportion to λ, so the same light needs no correction; a line of 20 nm acts as its centre."""
    assert spectral_factor(f"line:{line_nm}", peak_nm, width_nm) == pytest.approx(line_nm / peak_nm, rel=rel)


def test_stated_responsivity_is_used(tmp_path):
    """A responsivity twice as high at the light as at the calibration halves the reading."""
    file = tmp_path / "camera.csv"
    file.write_text("wavelength_nm,responsivity\n380,2\n500,2\n520,1\n780,1\n")
    assert spectral_factor("line:550", 453.0, 0.0, file) == pytest.approx(0.5, rel=1e-9)


@pytest.mark.parametrize(
    "text", ["a,b\n1,2\n", "wavelength_nm,responsivity\n500,1\n600,1\n", "wavelength_nm,responsivity\n"]
)
def test_unusable_responsivity_is_named(tmp_path, text):
    """A file of another form or too short a reach is refused."""
    file = tmp_path / "camera.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=r"camera\.csv"):
        spectral_factor("line:550", 453.0, 0.0, file)


def test_an_infrared_led_is_counted_by_its_photons():
    """With a flat efficiency its responsivity per watt is its mean wavelength, beyond the visible band too."""
    assert spectral_factor("line:550", 850.0, 40.0) == pytest.approx(550 / 850, rel=1e-4)
    assert spectral_factor("line:850", 550.0, 20.0) == pytest.approx(850 / 550, rel=1e-4)


def test_a_responsivity_that_ends_before_the_light_is_refused(tmp_path):
    """A table of the visible says nothing of 850 nm; one that reaches there is used."""
    file = tmp_path / "responsivity.csv"
    file.write_text("wavelength_nm,responsivity\n400,1\n700,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="the responsivity ends at 700 nm"):
        spectral_factor("line:550", 850.0, 40.0, file)
    file.write_text("wavelength_nm,responsivity\n400,1\n700,1\n701,0.25\n1000,0.25\n", encoding="utf-8")
    assert spectral_factor("line:550", 850.0, 40.0, file) == pytest.approx(4.0, rel=1e-4)


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


def test_a_scale_from_a_luminance_doubts_the_radiance(rig):
    """The efficacy's 40 % are in the radiance, and cancel in the luminance: there only the scale's 1 % is left."""
    found = reading(rig, "luminance")
    assert found.radiance.u_rel == pytest.approx(math.hypot(0.01, 0.4), rel=1e-3)
    assert found.luminance.u_rel == pytest.approx(0.01, rel=0.02)
    assert "spectrum_assumed" in found.flags


def test_a_scale_from_a_radiance_doubts_the_luminance(rig):
    """The other way round."""
    found = reading(rig, "radiance")
    assert found.radiance.u_rel == pytest.approx(0.01, rel=0.02)
    assert found.luminance.u_rel == pytest.approx(math.hypot(0.01, 0.4), rel=1e-3)


def test_a_camera_of_unknown_response_doubts_another_spectrum(rig):
    """Calibrated at 500 nm and read at 600 nm: a flat photon counter is off by ln 1.2, others by more or less."""
    found = reading(rig, "radiance", ("line:500", "line:600"))
    line = next(one.u_rel for one in found.budget if one.name == "spectral assumption")
    bells = [
        math.log(1.2) - math.log(2.0) * (((600 - peak) / 150) ** 2 - ((500 - peak) / 150) ** 2)
        for peak in (500, 550, 600)
    ]
    assert line == pytest.approx(math.sqrt(np.mean(np.square([math.log(1.2), *bells]))), rel=1e-6)
    assert unknown_mismatch_u_rel("white_led", "white_led") == pytest.approx(0.0, abs=1e-12)


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


def test_a_band_needs_a_width():
    """The message says what is missing."""
    with pytest.raises(InputError, match="after the comma"):
        spectrum("band:525")


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


def test_a_camera_that_counts_all_light_alike_leaves_the_radiance_alone():
    """Of a flat response per watt every light's radiance is right, to the response's own u; its luminance is not."""
    assert unstated_light_u_rel("white_led", FLAT) == pytest.approx(0.03)
    efficacy = {name: luminous_efficacy_lm_per_w(spectrum(name)) for names in KINDS.values() for name in names}
    off = [[(efficacy[one] / efficacy["white_led"] - 1.0) ** 2 for one in names] for names in KINDS.values()]
    expected = math.hypot(math.sqrt(np.mean([np.mean(kind) for kind in off])), 0.03)
    assert unstated_light_u_rel("white_led", FLAT, "photopic") == pytest.approx(expected, rel=1e-3)


def test_a_response_that_ends_before_the_light_says_nothing():
    """A table from 300 to 400 nm under a line at 600: as if there were none."""
    short = SpectralResponse(wavelength_nm=(300.0, 400.0), relative=(1.0, 1.0))
    assert unstated_light_u_rel("line:600", short) == unstated_light_u_rel("line:600", None)


def test_a_stated_figure_stands_in_place_of_all_kinds(rig):
    """`--stated spectral_u_rel=0.05` is what the user knows better; the flag stays."""
    stated = StatedUncertainties(spectral_u_rel=0.05)
    found = unstated(rig, rig.calibration(spectrum="white_led", uncertainties=stated))
    assert spectral_line(found).u_rel == pytest.approx(0.05)
    assert spectral_line(found).note.endswith("as stated")
    assert "spectrum_assumed" in found.flags


def test_relative_readings_have_no_spectrum(rig):
    """Without an absolute scale there is nothing that a spectrum could shift."""
    base = rig.calibration(spectrum="white_led")
    relative = replace(base, scale=base.scale.model_copy(update={"method": "relative"}))
    assert spectral_u_rel(relative, StatedUncertainties(), spectrum_stated=False) == 0.0
