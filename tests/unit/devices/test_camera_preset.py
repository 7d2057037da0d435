"""Presets of a camera, and settings out of range."""

import numpy as np
import pytest

from radiometer.data import CameraDescription
from radiometer.data.storage import read_yaml
from radiometer.devices import CameraPreset
from radiometer.errors import CalibrationError, ConfigurationError, SettingOutOfRange


def test_shipped_blackfly_has_the_figures_of_its_specification_page():
    """Sensor, pitch, bits and limits are those that FLIR states; the response per watt is highest at 580 nm."""
    preset = CameraPreset.shipped("BFS-U3-19S4M")
    limits = preset.require_limits("test")
    assert (limits.width, limits.height) == (1616, 1240)
    assert (preset.camera.pixel_pitch_um, preset.camera.bit_depth) == (4.5, 12)
    assert limits.exposure_s == (11e-6, 30.0)
    assert limits.gain_db == (0.0, 47.9943)
    response = CameraPreset.shipped("BFS-U3-19S4M").spectral_response
    assert response is not None
    nm, relative = np.array(response.wavelength_nm), np.array(response.relative)
    assert nm[relative.argmax()] == 580.0
    assert np.interp((400.0, 820.0, 1100.0), nm, relative) == pytest.approx((0.5, 0.47, 0.01), abs=0.02)
    assert "IMX428" in response.source


def test_every_figure_of_every_shipped_camera_has_a_source(project_root):
    """No value of a camera file stands without saying where it comes from."""
    files = sorted((project_root / "configs" / "cameras").glob("*.yaml"))
    assert files
    for path in files:
        content = read_yaml(path)
        figures = {*content["camera"], *content.get("limits", {}), *({"spectral_response"} & set(content))}
        assert figures - set(content["sources"]) == set(), path.name


def test_unknown_camera_is_refused_with_those_that_there_are():
    """The message lists the shipped cameras."""
    with pytest.raises(ConfigurationError, match=r"no shipped configuration .*BFS-U3-19S4M\.yaml"):
        CameraPreset.shipped("BFS-U3-00S0M")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera": {"bit_depth": 12, "colour": "red"}}, r"unknown key 'camera\.colour'; allowed here: .*bit_depth"),
        ({"camera": {"bit_depth": 99}}, r"camera\.bit_depth = 99: input should be less than or equal to 16"),
        ({"limits": {"width": 8, "height": 8, "exposure_s": [1, 0.1]}}, r"lowest value 1 is above the highest 0\.1"),
        ({"limits": {"width": 8, "height": 8, "exposure_s": [0, 1]}}, r"shortest exposure must be above 0"),
        ({"limits": {"width": 8, "height": 8, "exposure_s": [1e-5, 1], "x": 1}}, r"unknown key 'limits\.x'"),
        ({"format": "radiometer-camera/9"}, r"format = 'radiometer-camera/9'"),
    ],
)
def test_what_is_wrong_is_named_with_its_key(change, message):
    """Each mistake is answered with file, key and what is allowed."""
    mapping = {"format": "radiometer-camera/1", "camera": {"bit_depth": 12}} | change
    with pytest.raises(ConfigurationError, match=message):
        CameraPreset.from_mapping(mapping, "camera.yaml")


CHARACTERISED = {
    "format": "radiometer-camera/1",
    "camera": {"bit_depth": 12, "model": "M", "serial": "7", "conversion_gain_e_per_dn": 2.5, "read_noise_e": 3.1},
    "emva1288": {"figures": {"R": {"value": 0.2, "u": 0.004, "unit": "DN/photon"}}},
}


def test_measured_figures_replace_those_of_a_description():
    """Gain and noise come from the file; what it does not hold stays."""
    preset = CameraPreset.from_mapping(CHARACTERISED, "camera.yaml")
    described = CameraDescription(bit_depth=12, model="M", conversion_gain_e_per_dn=2.0, full_well_e=9000)
    applied = preset.applied_to(described, "camera.yaml")
    assert (applied.conversion_gain_e_per_dn, applied.read_noise_e, applied.full_well_e) == (2.5, 3.1, 9000)
    assert preset.figure_u_rel("R") == pytest.approx(0.02)
    assert preset.figure_u_rel("K") is None


@pytest.mark.parametrize("other", [{"serial": "8"}, {"model": "N"}, {"bit_depth": 10}])
def test_file_of_another_camera_is_refused(other):
    """The message names what differs."""
    described = CameraDescription.model_validate({"bit_depth": 12, "model": "M", "serial": "7"} | other)
    preset = CameraPreset.from_mapping(CHARACTERISED, "camera.yaml")
    with pytest.raises(CalibrationError, match=rf"camera\.yaml is of another camera: its {next(iter(other))} is"):
        preset.applied_to(described, "camera.yaml")


@pytest.mark.parametrize(
    ("value", "reported"),
    [(float("nan"), "nan"), (48.00000001, "48.00000001"), (-1e-9, "-1e-09"), (48.0 + 7.2e-15, "48.000000000000007")],
)
def test_a_hair_beyond_is_seen(value, reported):
    """48 dB is not out of a range that ends at 48 dB; 48.00000001 dB is."""
    error = SettingOutOfRange("camera", "gain", value, 0.0, 48.0, "dB")
    assert str(error) == f"camera: gain {reported} dB is out of range; allowed is 0 to 48 dB"
