"""`radiometer characterise` and `radiometer flux`."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.data.storage import write_yaml_atomic
from radiometer.devices import CameraPreset
from simulators.chain.camera_model import CameraModel
from simulators.scenes import LedScene, UniformScene
from testing.simulated_capture import simulate_capture


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    camera = CameraDescription(
        bit_depth=12,
        pixel_pitch_um=4.5,
        conversion_gain_e_per_dn=2.6,
        read_noise_e=3.0,
        full_well_e=10_500,
        black_level_dn=64,
        quantum_efficiency=0.62,
    )
    times = [float(t) for t in np.linspace(0.002, 0.05, 12)]
    plan = [FrameSettings(t, shutter=s) for s in ("open", "closed") for t in times]  # type: ignore[arg-type]
    model = CameraModel.ideal(camera, LensDescription(f_number=4.0))
    scene = UniformScene(radiance_W_per_sr_m2=0.14)
    simulate_capture(model, plan, scene, tmp_path / "set", frames_per_setting=2, width=64, height=48)
    return tmp_path / "set"


def test_json_and_camera_file_hold_the_same_figures(capture, tmp_path, capsys):
    """Standard output is one JSON object; the YAML file is a camera preset with the same conversion gain."""
    assert run(["characterise", str(capture), "-o", str(tmp_path / "camera.yaml"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["format"] == "radiometer-camera/1"
    assert printed["emva1288"]["figures"]["K"]["unit"] == "DN/e-"
    preset = CameraPreset.read(tmp_path / "camera.yaml")
    assert preset.camera.conversion_gain_e_per_dn == printed["camera"]["conversion_gain_e_per_dn"]


@pytest.mark.slow
def test_table_names_symbols_and_report_is_written(capture, tmp_path, capsys):
    """The table shows symbols with k = 2 uncertainties; the datasheet is an HTML page."""
    assert run(["characterise", str(capture), "--report", str(tmp_path / "sheet.html")]) == 0
    out = capsys.readouterr().out
    assert "overall" in out
    assert "U (k = 2)" in out
    assert (tmp_path / "sheet.html").read_text().startswith("<!doctype html>")


@pytest.mark.slow
def test_camera_is_driven_and_its_limits_stand_in_the_file(tmp_path):
    """With --camera sim the frames are taken from the bench file's camera, and the file can be simulated again."""
    bench = {
        "camera": {"kind": "simulated", "preset": "BFS-U3-19S4M", "width": 64, "height": 48},
        "lens": {"focal_length_mm": 16, "f_number": 4},
        "scene": {"kind": "uniform", "radiance_W_per_sr_m2": 0.3},
        "source": {"kind": "sphere", "wavelength_nm": 550},
        "patch": {"x": 0, "y": 0, "width": 64, "height": 48},
    }
    write_yaml_atomic(tmp_path / "bench.yaml", bench)
    words = ["--bench", str(tmp_path / "bench.yaml"), "--radiance", "0.3", "--steps", "12"]
    assert run(["characterise", "--camera", "sim", *words, "-o", str(tmp_path / "camera.yaml"), "--json"]) == 0
    preset = CameraPreset.read(tmp_path / "camera.yaml")
    assert preset.require_limits("test").width == 64
    # 18 frames' pairs of 3072 pixels give K, and so the efficiency, to about 1 %.
    assert preset.camera.quantum_efficiency == pytest.approx(0.62, rel=0.05)
    CameraModel.ideal(preset.camera, LensDescription(f_number=4.0))


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([], 2, "name a capture set (or descriptor file), or a camera with --camera"),
        (["nowhere"], 1, "nowhere does not exist"),
        (["nowhere", "--camera", "sim"], 2, "one of both"),
    ],
)
def test_misuse_is_one_line_with_its_exit_code(words, code, message, capsys):
    """Neither or both of capture and camera is misuse; a missing folder is a failure."""
    assert run(["characterise", *words]) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.fixture
def flux_capture(tmp_path: Path) -> Path:
    """Return a bracket of a 5 mW diode of half angle 60° and 3 mm at 80 mm from a 20 mm lens."""
    camera = CameraDescription(
        bit_depth=12,
        pixel_pitch_um=18.0,
        conversion_gain_e_per_dn=20.0,
        read_noise_e=10.0,
        full_well_e=90_000,
        black_level_dn=64,
        quantum_efficiency=0.6,
    )
    lens = LensDescription(focal_length_mm=20, f_number=4.0, transmittance=0.9, magnification=1 / 3)
    scene = LedScene(
        flux_mW=5.0,
        emitter_diameter_mm=3.0,
        half_angle_deg=60.0,
        pupil_half_angle_deg=math.degrees(math.atan(2.5 / 80)),
        diameter_px=1 / 18e-3,
    )
    plan = [FrameSettings(t) for t in (2e-5, 1e-4, 5e-4, 2e-3)]
    simulate_capture(CameraModel.ideal(camera, lens, 590.0), plan, scene, tmp_path / "set", width=96, height=96)
    return tmp_path / "set"


def test_json_gives_thesis_and_emitted_flux(flux_capture, capsys):
    """The emitted flux is 5 mW within its k = 2 uncertainty; the thesis's figure is next to it."""
    words = ["--half-angle", "60", "--distance", "80", "--diameter", "3", "--datasheet-mw", "5", "--json"]
    assert run(["flux", str(flux_capture), *words]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["result"]["value"] == pytest.approx(5e-3, abs=2 * printed["result"]["u"])
    assert printed["thesis_2_13"]["value"] < 0.1e-3
    assert printed["thesis_2_13"]["unit"] == "W"
    assert set(printed["emitted"]) == {"fraction_through_pupil", "radiance_times_area"}


def test_table_shows_how_the_gap_closes(flux_capture, capsys):
    """Each step has its flux and the share that it closes."""
    assert run(["flux", str(flux_capture), "--half-angle", "60", "--distance", "80", "--datasheet-mw", "5"]) == 0
    out = capsys.readouterr().out
    assert "light that missed the lens" in out
    assert "open: " in out


def test_without_a_half_angle_the_way_to_the_emitted_flux_is_named(flux_capture, capsys):
    """Only the flux through the sensor is given."""
    assert run(["flux", str(flux_capture)]) == 0
    assert "for the emitted flux give --half-angle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--distance", "80"], 2, "needs --half-angle"),
        (["--half-angle", "95"], 2, "half angle 95° is out of range"),
        (["--half-angle", "60", "--datasheet-mw", "0"], 2, "datasheet_mw is 0.0 (float); give finite number above 0"),
        (["--patch", "90,0,40,40"], 1, "is not on the frame of 96 × 96"),
    ],
)
def test_misuse_is_one_line(flux_capture, words, code, message, capsys):
    """What is missing or impossible is stated with the way out."""
    if words[:2] == ["--half-angle", "95"]:
        words = [*words, "--distance", "80"]
    assert run(["flux", str(flux_capture), *words]) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_characterised_camera_gives_the_scale_and_its_uncertainty(flux_capture, tmp_path, capsys):
    """With a camera file the 3 % of an uncharacterised camera no longer count; with a calibration it is misuse."""
    file = {
        "format": "radiometer-camera/1",
        "camera": {"bit_depth": 12, "quantum_efficiency": 0.6, "conversion_gain_e_per_dn": 20.0},
        "emva1288": {"figures": {"R": {"value": 0.03, "u": 0.0003, "unit": "DN/photon"}}},
    }
    write_yaml_atomic(tmp_path / "camera.yaml", file)
    words = ["flux", str(flux_capture), "--json", "--camera-file", str(tmp_path / "camera.yaml")]
    assert run(words) == 0
    flux = json.loads(capsys.readouterr().out)["on_sensor"]
    assert flux["u"] / flux["value"] == pytest.approx(0.01, rel=0.05)
    assert run([*words, "--calibration", "x.yaml"]) == 2
