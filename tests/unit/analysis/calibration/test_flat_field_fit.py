"""The flat field: found from an even source, honest about itself, and carried into readings."""

import json

import numpy as np
import pytest

from radiometer.analysis.calibration.flat_field import fit_flat_field
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import read_patch
from radiometer.cli.main import run
from radiometer.data import Bracket, Calibration, CaptureSetWriter, FlatField, Patch, RadianceMap
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, MeasurementError

SHAPE = (120, 160)
CENTRE = (84.0, 57.0)


def falloff(k2=-0.18, k4=-0.05, focal_px=150.0):
    """Return the sensitivity of a made-up lens: cos⁴ and a mechanical part."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    r2 = (x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2
    rho2 = r2 / (np.hypot(*SHAPE) / 2) ** 2
    return (1 + k2 * rho2 + k4 * rho2**2) / (1 + r2 / focal_px**2) ** 2


def wide(rig):
    """Return camera and lens of a wide lens: 150 pixels of focal length."""
    return (
        rig.description.model_copy(update={"pixel_pitch_um": 4.5}),
        rig.lens.model_copy(update={"focal_length_mm": 150 * 4.5e-3}),
    )


def even_map(sensitivity, noise=0.002, seed=1):
    value = sensitivity * (1 + noise * np.random.default_rng(seed).standard_normal(SHAPE))
    return RadianceMap(
        value.astype(np.float32), np.full(SHAPE, noise, np.float32), np.zeros(SHAPE, np.uint8), "relative"
    )


def test_the_falloff_is_found_next_to_dust(rig):
    """Principal point to 1.5 pixels, sensitivity to 0.1 % of the axis; a shadow of 30 % leaves the rest to 0.2 %."""
    camera, lens = wide(rig)
    flat = fit_flat_field(even_map(falloff()), camera, lens)
    assert np.hypot(flat.principal_point_px[0] - CENTRE[0], flat.principal_point_px[1] - CENTRE[1]) < 1.5
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    np.testing.assert_allclose(flat.at(x, y), falloff(), atol=1e-3)
    shadow = falloff()
    shadow[20:28, 30:38] *= 0.7
    flat = fit_flat_field(even_map(shadow), camera, lens)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    np.testing.assert_allclose(flat.at(x, y), falloff(), atol=2e-3)


@pytest.mark.slow
def test_its_stated_uncertainty_is_that_of_the_correction(rig):
    """Over 20 noisy maps the rms error of the correction stays within a factor of 2 of what is stated."""
    camera, lens = wide(rig)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    errors, stated = [], []
    for seed in range(20):
        flat = fit_flat_field(even_map(falloff(), 0.01, seed), camera, lens)
        errors.append(np.sqrt(np.mean((flat.at(x, y) / falloff() - 1) ** 2)))
        stated.append(flat.u_rel)
    assert 0.5 < np.mean(stated) / np.sqrt(np.mean(np.square(errors))) < 2.0


def test_terms_earn_their_place(rig):
    """Of eight even maps six are given none; without a focal length three even powers follow cos⁴ to 0.2 %."""
    camera, lens = wide(rig)
    found = [fit_flat_field(even_map(falloff(0.0, 0.0), 0.01, seed), camera, lens) for seed in range(8)]
    assert sum(flat.coefficients == (0.0, 0.0, 0.0) for flat in found) >= 6
    camera, moderate = rig.description, falloff(focal_px=300.0)
    flat = fit_flat_field(even_map(moderate), camera, rig.lens.model_copy(update={"focal_length_mm": None}))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    assert flat.focal_length_px is None
    np.testing.assert_allclose(flat.at(x, y) / flat.at(np.array(CENTRE[0]), np.array(CENTRE[1])), moderate, atol=2e-3)


def test_what_the_model_cannot_follow_is_stated_with_the_source_s_unevenness(rig):
    """A ripple of 1 % leaves 0.7 %; unevenness adds in squares."""
    camera, lens = wide(rig)
    ripple = 1 + 0.01 * np.sin(np.arange(SHAPE[1]) / 6.0)
    flat = fit_flat_field(even_map(falloff() * ripple), camera, lens)
    assert flat.u_rel == pytest.approx(0.01 / np.sqrt(2), rel=0.25)
    one = fit_flat_field(even_map(falloff()), camera, lens)
    two = fit_flat_field(even_map(falloff()), camera, lens, source_u_rel=0.02)
    assert two.u_rel == pytest.approx(np.hypot(one.u_rel, 0.02))


@pytest.mark.parametrize(
    ("picture", "clipped_from", "message"),
    [
        (lambda x: np.exp(-(falloff() ** -1 - 1) * 40.0) + 1e-4, None, "even source"),
        (lambda x: falloff() * x, None, "the light was not even|no even source"),
        (lambda x: falloff() * np.where(x > 1.7, np.round(4 * x), 1.0), None, "the light was not even|no even source"),
        (lambda x: falloff(), 0, "half of full scale"),
        (lambda x: falloff(), SHAPE[1] // 3, "half of full scale"),
    ],
    ids=["a spot in the dark", "twice as bright at the right", "a chart", "all clipped", "two thirds clipped"],
)
def test_light_that_is_not_even_is_no_fall_off(rig, picture, clipped_from, message):
    """What no lens's fall-off can be, what moves the fitted axis far off the lens's, and what is mostly clipped."""
    camera, lens = wide(rig)
    found = even_map(picture(np.linspace(1.0, 2.0, SHAPE[1])[None, :]))
    if clipped_from is not None:
        found.mask[:, clipped_from:] = 1
    with pytest.raises(MeasurementError, match=message):
        fit_flat_field(found, camera, lens)


@pytest.mark.parametrize(
    ("of_camera", "of_lens", "message"),
    [
        ({"model": "other"}, {}, "its model is"),
        ({"serial": "999"}, {}, "its serial is"),
        ({"pixel_pitch_um": 9.0}, {}, "its pixel pitch"),
        ({}, {"focal_length_mm": 16.0}, "the one in use has 16 mm"),
        ({}, {"magnification": 1.0}, "has a magnification of 1, at calibration 0"),
        ({}, {"principal_point_px": (200.0, 9.0)}, "another part of the sensor"),
    ],
)
def test_a_flat_field_of_another_camera_or_lens_is_refused(rig, of_camera, of_lens, message, tmp_path, capsys):
    """The fall-off is that of one lens on one sensor: what a calibration and a reading must share holds for it too."""
    camera, lens = wide(rig)
    camera, rng = camera.model_copy(update={"model": "one", "serial": "123"}), np.random.default_rng(5)
    lens = lens.model_copy(update={"principal_point_px": CENTRE})
    others = camera.model_copy(update=of_camera), lens.model_copy(update=of_lens)
    radiance = 0.5 * rig.radiance_of_full_scale(1e-3)
    for name, described in (("flat", others), ("known", (camera, lens))):
        with CaptureSetWriter(tmp_path / name, *described) as writer:
            for _ in range(2):
                writer.add(rig.frame(radiance * falloff(), 1e-3, rng))
    words = ["calibrate", str(tmp_path / "known"), "--patch", "20,20,20,20", "--radiance", str(radiance)]
    words += ["--u-rel", "0.001", "--flat", str(tmp_path / "flat"), "-o", str(tmp_path / "cal.yaml")]
    assert run(words) == 1
    error = " ".join(capsys.readouterr().err.split())
    assert "flat field" in error
    assert message in error


def test_a_flat_field_has_the_f_number_of_its_frames(rig, tmp_path, capsys):
    """Mechanical vignetting depends on the iris: what counts is where it stood for the flat frames."""
    camera, lens = wide(rig)
    radiance, rng = 0.5 * rig.radiance_of_full_scale(1e-3), np.random.default_rng(5)
    for name, stop in (("flat", 8.0), ("known", 4.0)):
        with CaptureSetWriter(tmp_path / name, camera, lens) as writer:
            for _ in range(2):
                writer.add(rig.but(f_number=stop).frame(radiance * (stop / 4.0) ** 2 * falloff(), 1e-3, rng))
    words = ["calibrate", str(tmp_path / "known"), "--patch", "20,20,20,20", "--radiance", str(radiance)]
    words += ["--u-rel", "0.001", "--flat", str(tmp_path / "flat"), "--json", "-o", str(tmp_path / "cal.yaml")]
    assert run(words) == 0
    assert json.loads(capsys.readouterr().out)["flat_field"]["f_number"] == 8.0


def test_the_command_fits_stores_and_applies_it(rig, tmp_path, capsys):
    """From flat frames and a known patch off the axis to a reading in a corner: right within its interval."""
    camera, lens = wide(rig)
    sensitivity, rng = falloff(), np.random.default_rng(5)
    radiance = 0.5 * rig.radiance_of_full_scale(1e-3)
    for name, level in (("flat", 1.0), ("known", 0.8)):
        with CaptureSetWriter(tmp_path / name, camera, lens) as writer:
            for _ in range(6):
                writer.add(rig.frame(level * radiance * sensitivity, 1e-3, rng))
    words = ["calibrate", str(tmp_path / "known"), "--patch", "20,20,20,20", "--radiance", str(0.8 * radiance)]
    words += ["--u-rel", "0.001", "--flat", str(tmp_path / "flat"), "--json", "-o", str(tmp_path / "cal.yaml")]
    assert run(words) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["flat_field"]["shape"] == list(SHAPE)
    assert run([*(word for word in words if word != "--json"), "--force"]) == 0
    x, y = report["flat_field"]["principal_point_px"]
    assert f"flat field fitted about {x:.1f}, {y:.1f} px" in " ".join(capsys.readouterr().out.split())
    calibration = Calibration.read(tmp_path / "cal.yaml")
    frames = [rig.frame(0.3 * radiance * sensitivity, 1e-3, rng) for _ in range(4)]
    reading = read_patch(frames, Patch(2, 100, 16, 16), Setup(camera, lens, calibration))
    assert abs(reading.radiance.value - 0.3 * radiance) < 2 * reading.radiance.u
    assert reading.radiance.u_rel < 0.006
    found = merge(Bracket.from_frames(frames), Setup(camera, lens, calibration))
    tiles = found.radiance.reshape(12, 10, 16, 10).mean(axis=(1, 3)) / (0.3 * radiance)
    np.testing.assert_allclose(tiles, 1.0, atol=0.006)


def test_a_flat_field_of_another_size_is_refused(rig):
    """Cropping or binning moves the axis."""
    camera, lens = wide(rig)
    flat = fit_flat_field(even_map(falloff()), camera, lens)
    frames = rig.frames(np.full((20, 20), rig.radiance_of_full_scale(1e-3) / 2), np.random.default_rng(1), (1e-3,))
    with pytest.raises(CalibrationError, match="160 × 120"):
        read_patch(frames, Patch(0, 0, 9, 9), Setup(rig.description, rig.lens, rig.calibration(flat_field=flat)))
    with pytest.raises(CalibrationError, match="160 × 120"):
        merge(frames, Setup(rig.description, rig.lens, rig.calibration(flat_field=flat)))


def test_coefficients_are_those_at_half_the_diagonal(rig):
    """In powers of the distance over that of a corner; without any the field is flat."""
    camera, lens = wide(rig)
    flat = fit_flat_field(even_map(falloff(), 1e-7), camera, lens)
    assert flat.radius_px == 100.0
    assert flat.coefficients == pytest.approx((-0.18, -0.05, 0.0), abs=3e-3)
    flat = FlatField(principal_point_px=(50.0, 40.0), radius_px=64.0, shape=(80, 100))
    assert flat.at(np.array([50.0, 0.0, 100.0]), np.array([40.0, 0.0, 80.0])) == pytest.approx([1.0, 1.0, 1.0])


@pytest.mark.parametrize("stated", [None, (50.0, 60.0)])
def test_a_picture_without_falloff_has_the_point_of_the_lens_or_the_middle_pixel(rig, stated):
    """Of 160 × 120 pixels, counted from 0, the middle lies at 79.5 and 59.5."""
    camera, lens = wide(rig)
    lens = lens.model_copy(update={"principal_point_px": stated, "focal_length_mm": None})
    flat = fit_flat_field(even_map(np.ones(SHAPE)), camera, lens)
    assert flat.principal_point_px == (stated or (79.5, 59.5))
