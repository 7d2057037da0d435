"""What a bench or a capture states of its light is the light that is read, whatever the calibration was made with."""

import pytest
import yaml

import radiometer as rm
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum

PATCH = (10, 10, 16, 16)
BENCH = {
    "format": "radiometer-bench/1",
    "camera": {
        "kind": "simulated", "preset": "BFS-U3-19S4M", "serial": "22500001", "width": 64, "height": 48,
        "black_level_dn": 64,
    },
    "lens": {"focal_length_mm": 16, "f_number": 4},
    "scene": {"kind": "uniform", "radiance_W_per_sr_m2": 1.0},
}  # fmt: skip


@pytest.fixture
def readings(tmp_path):
    """Return a function that reads 1 W·sr⁻¹·m⁻² of a line at 600 nm live and from a capture set, and calibrates."""

    def read(**asked):
        bench = tmp_path / "bench.yaml"
        bench.write_text(yaml.safe_dump(BENCH | {"source": {"kind": "led", "wavelength_nm": 600}}))
        rm.bracket(tmp_path / "set", bench=bench, patch=PATCH)
        stated = {"patch": PATCH, "radiance": 1.0, "u_rel": 0.005}
        made = rm.calibrate(tmp_path / "set", **stated).calibration
        white = rm.calibrate(tmp_path / "set", spectrum="white_led", **stated).calibration
        white.write(tmp_path / "white.yaml")
        live = rm.measure(bench=bench, patch=PATCH, calibration=tmp_path / "white.yaml", **asked)
        return made, live, rm.measure_photographs(tmp_path / "set", PATCH, calibration=tmp_path / "white.yaml", **asked)

    return read


def test_a_stated_wavelength_is_the_light_of_readings_and_of_a_scale(readings):
    """683 lm/W · V(600 nm) relates radiance and luminance, not the efficacy of the white light of the calibration."""
    made, *found = readings()
    assert made.spectrum == made.scale.spectrum == "line:600"
    for reading in found:
        assert reading.luminance.value / reading.radiance.value == pytest.approx(683.0 * 0.631, rel=2e-3)
        assert "spectrum line:600" in reading.more["assumptions"]


def test_a_spectrum_that_is_asked_for_comes_before_the_wavelength(readings):
    """A user knows the light better than a bench file."""
    _, *found = readings(spectrum="display_green")
    for reading in found:
        efficacy = luminous_efficacy_lm_per_w(spectrum("display_green"), "photopic")
        assert reading.luminance.value / reading.radiance.value == pytest.approx(efficacy, rel=1e-6)
