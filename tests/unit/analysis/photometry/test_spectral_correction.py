"""Correction of readings for light of another colour than the camera was calibrated with."""

from __future__ import annotations

import pytest

from radiometer.analysis.photometry.spectral_correction import spectral_factor
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
