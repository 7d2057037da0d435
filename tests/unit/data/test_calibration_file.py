"""Calibration files: one YAML, whole round trip, refusals that name the key."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.calibration.shared import require_camera, require_lens
from radiometer.data import (
    BlackLevel,
    Calibration,
    CameraDescription,
    FlatField,
    LensDescription,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from radiometer.errors import CalibrationError, InputError

CAMERA = CameraDescription(bit_depth=12, model="BFS-U3-19S4M", serial="7", full_well_e=10500.0)


@pytest.fixture
def calibration() -> Calibration:
    """Return a calibration with every part present."""
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(np.log(dn / 2048), np.full(4096, 0.002), valid_dn=(10, 4000))
    return Calibration(
        camera=CAMERA,
        lens=LensDescription(focal_length_mm=16.0, f_number=4.0),
        scale=Scale(value=1.3e-3, u_rel=0.01, method="known_radiance", f_number=4.0),
        response=curve,
        noise=SensorNoise.of(CAMERA),
        black_level=BlackLevel(dn=64.0, u_dn=0.1),
        flat_field=FlatField(principal_point_px=(8.0, 6.0), radius_px=10.0, shape=(12, 16), u_rel=0.002),
        spectrum="cie_d65",
        defects=((3, 4),),
        created="2026-01-02T03:04:05+00:00",
    )


def test_a_written_calibration_reads_back_the_same(calibration, tmp_path):
    """Every part survives the file, the curve to nine digits."""
    calibration.write(tmp_path / "cal.yaml")
    back = Calibration.read(tmp_path / "cal.yaml")
    for name in ("camera", "lens", "scale", "noise", "black_level", "flat_field", "spectrum", "defects", "created"):
        assert getattr(back, name) == getattr(calibration, name), name
    assert np.isneginf(back.response.log_exposure[0])
    np.testing.assert_allclose(back.response.log_exposure[1:], calibration.response.log_exposure[1:], atol=1e-8)
    assert back.response.valid_dn == (10, 4000)


@pytest.mark.parametrize(
    ("change", "named"), [({"model": "other"}, "model"), ({"serial": "8"}, "serial"), ({"bit_depth": 8}, "bit depth")]
)
def test_another_camera_is_refused(calibration, change, named):
    """The message names what differs."""
    with pytest.raises(CalibrationError, match=named):
        require_camera(calibration, CAMERA.model_copy(update=change))


def test_a_serial_number_fits_in_either_notation(calibration):
    """A file that was written with the label's number fits the camera that USB reports; another camera's does not."""
    known = replace(calibration, camera=CAMERA.model_copy(update={"serial": "20497219"}))
    require_camera(known, CameraDescription(bit_depth=12, serial="0138C343"))
    with pytest.raises(CalibrationError, match="its serial is 20497219"):
        require_camera(known, CameraDescription(bit_depth=12, serial="0138C344"))


def test_what_is_unknown_is_not_compared(calibration):
    """A camera without a serial number is not refused for it."""
    require_camera(calibration, CameraDescription(bit_depth=12))


def test_another_lens_is_refused(calibration):
    """A lens of another focal length has another transmittance and field."""
    require_lens(calibration, LensDescription(f_number=8.0))
    with pytest.raises(CalibrationError, match="25 mm"):
        require_lens(calibration, LensDescription(focal_length_mm=25.0))


@pytest.mark.parametrize(("focal_mm", "taken"), [(16.16, True), (16.17, False), (15.85, True), (15.84, False)])
def test_a_focal_length_fits_within_a_hundredth(calibration, focal_mm, taken):
    """Of 16 mm, to either side; one that is unknown is not compared."""
    lens = LensDescription(focal_length_mm=focal_mm)
    if taken:
        require_lens(calibration, lens)
    else:
        with pytest.raises(CalibrationError, match="made with a lens of 16 mm"):
            require_lens(calibration, lens)
    require_lens(replace(calibration, lens=LensDescription()), lens)


def test_it_goes_stale_after_its_validity(calibration):
    """The day of expiry itself still counts as valid."""
    made = dt.datetime(2026, 1, 2, 3, 4, 5, tzinfo=dt.UTC)
    assert not calibration.is_stale(made + dt.timedelta(days=365))
    assert calibration.is_stale(made + dt.timedelta(days=365, seconds=1))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "radiometer-capture/1", "radiometer-calibration/1"),
        ("created", "2026-01-02T03:04:05", "created"),
        ("created", "yesterday", "created"),
        ("validity_days", -1, "validity_days"),
        ("scale", None, "scale"),
        ("scale", {"value": 0, "u_rel": 0.1, "method": "known_radiance"}, "scale.value"),
        ("scale", {"value": 1, "u_rel": 0.1, "method": "guess"}, "scale.method"),
        ("noise", {"read_noise_e": 2}, "conversion_gain_e_per_dn"),
        ("camera", {"bit_depth": 10}, "10"),
        ("black", {"dn": 70}, "unknown key 'black'; allowed here: black_level"),
        ("uncertainties", {"drift": 0.1}, "unknown key 'uncertainties.drift'"),
        ("camera", {"bit_depth": 12, "serial_number": "1"}, "write 'serial'"),
        ("response", {"format": "radiometer-response/1", "valid": [3, 4000]}, "unknown key 'valid'; allowed here"),
    ],
)
def test_a_wrong_entry_is_refused_by_name(calibration, key, value, message):
    """The message names the key, or shows the value."""
    mapping = {**calibration.to_mapping(), key: value}
    with pytest.raises((CalibrationError, InputError), match=message):
        Calibration.from_mapping(mapping, "cal.yaml")


def test_a_missing_key_is_named(calibration):
    """A calibration without its scale says so."""
    mapping = calibration.to_mapping()
    del mapping["scale"]
    with pytest.raises(CalibrationError, match="'scale' is missing"):
        Calibration.from_mapping(mapping, "cal.yaml")


def test_a_damaged_table_is_refused(calibration):
    """Letters among the numbers of the curve are reported with the key."""
    mapping = calibration.to_mapping()
    mapping["response"]["log_exposure"] = "0 1 two"
    with pytest.raises(CalibrationError, match=r"response\.log_exposure"):
        Calibration.from_mapping(mapping, "cal.yaml")


def test_a_file_that_is_not_yaml_is_refused(tmp_path):
    """The error is one of ours, with the line."""
    (tmp_path / "cal.yaml").write_text("a: [1, 2")
    with pytest.raises(InputError, match=r"cal\.yaml"):
        Calibration.read(tmp_path / "cal.yaml")
