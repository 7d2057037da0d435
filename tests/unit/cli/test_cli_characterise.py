"""`radiometer characterise` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.data.storage import write_yaml_atomic
from radiometer.devices import CameraPreset
from simulators.chain.camera_model import CameraModel
from simulators.scenes import UniformScene
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


def test_json_and_camera_file_hold_the_same_figures(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard output is one JSON object; the YAML file is a camera preset with the same conversion gain."""
    assert run(["characterise", str(capture), "-o", str(tmp_path / "camera.yaml"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["format"] == "radiometer-camera/1"
    assert printed["emva1288"]["figures"]["K"]["unit"] == "DN/e-"
    preset = CameraPreset.read(tmp_path / "camera.yaml")
    assert preset.camera.conversion_gain_e_per_dn == printed["camera"]["conversion_gain_e_per_dn"]


@pytest.mark.slow
def test_table_names_symbols_and_report_is_written(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table shows symbols with k = 2 uncertainties; the datasheet is an HTML page."""
    assert run(["characterise", str(capture), "--report", str(tmp_path / "sheet.html")]) == 0
    out = capsys.readouterr().out
    assert "overall" in out
    assert "U (k = 2)" in out
    assert (tmp_path / "sheet.html").read_text().startswith("<!doctype html>")


@pytest.mark.slow
def test_camera_is_driven_and_its_limits_stand_in_the_file(tmp_path: Path) -> None:
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
def test_misuse_is_one_line_with_its_exit_code(
    words: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither or both of capture and camera is misuse; a missing folder is a failure."""
    assert run(["characterise", *words]) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
