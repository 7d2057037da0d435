"""Bad input to the main job's commands: one clear line, exit code 1 or 2, no traceback, nothing half-written."""

from __future__ import annotations

import os

import cv2
import numpy as np
import pytest
import yaml

from radiometer.cli.main import run
from radiometer.data.config_files import shipped_config


@pytest.fixture
def run_failing(capsys):
    """Return a function that runs the command line and returns exit code and what it stated on standard error."""

    def call(*words):
        code = run([str(word) for word in words])
        return code, capsys.readouterr().err

    return call


def write_photographs(folder, levels, times):
    """Write uniform-ish 8-bit PNGs with a list of their times."""
    folder.mkdir()
    ramp = np.linspace(0.0, 1.0, 64)[None, :] * np.ones((48, 1))
    lines = []
    for number, (level, seconds) in enumerate(zip(levels, times, strict=True)):
        cv2.imwrite(str(folder / f"{number}.png"), np.clip(ramp * level, 0, 255).astype(np.uint8))
        lines.append(f"{number}.png {seconds}")
    (folder / "exposures.txt").write_text("\n".join(lines) + "\n")
    return folder


def edited_bench(tmp_path, change):
    """Write the simulated bench with a change."""
    mapping = yaml.safe_load(shipped_config("bench-simulated.yaml").read_text())
    change(mapping)
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return path


def edited_calibration(tmp_path, **camera):
    """Write the shipped calibration with another camera in it."""
    mapping = yaml.safe_load(shipped_config("calibrations/simulated.yaml").read_text())
    mapping["camera"].update(camera)
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return path


def saturate(folder):
    for file in folder.glob("*.png"):
        cv2.imwrite(str(file), np.full((48, 64), 255, np.uint8))


LEVELS, TIMES = [60, 120, 240], [0.1, 0.2, 0.4]
FOLDERS = {
    "an empty folder": ([], [], lambda folder: (folder / "exposures.txt").unlink(), "empty"),
    "one exposure": ([200], [0.1], lambda folder: None, "exposure"),
    "saturated frames": (LEVELS, TIMES, saturate, "clip"),
    "two sizes": (
        LEVELS,
        TIMES,
        lambda folder: cv2.imwrite(str(folder / "1.png"), np.zeros((40, 64), np.uint8)),
        "64 × 40",
    ),
    "two depths": (
        LEVELS,
        TIMES,
        lambda folder: cv2.imwrite(str(folder / "1.png"), np.full((48, 64), 999, np.uint16)),
        "bit",
    ),
    "half a picture": (LEVELS, TIMES, lambda folder: os.truncate(folder / "1.png", 60), "1.png"),
    "no times": (LEVELS, TIMES, lambda folder: (folder / "exposures.txt").unlink(), "exposures.txt"),
    "a label that lies": ([30, *LEVELS], [0.1, 0.2, 0.05, 0.8], lambda folder: None, ".png"),
}


@pytest.mark.parametrize("name", FOLDERS)
def test_photographs_that_hold_no_response(run_failing, tmp_path, name):
    """The message names the file, or what is missing or contradicts, and no response is written."""
    levels, times, harm, named = FOLDERS[name]
    harm(folder := write_photographs(tmp_path / "p", levels, times))
    code, line = run_failing("response", folder, "-o", tmp_path / "c.csv")
    assert code == 1
    assert named in line
    assert not (tmp_path / "c.csv").exists()


def test_a_bench_with_an_unknown_key(run_failing, tmp_path):
    """The key and what is allowed are named; misuse has exit code 2."""
    code, line = run_failing("measure", "--bench", edited_bench(tmp_path, lambda m: m.update(lenz=1)))
    assert code == 2
    assert "unknown key 'lenz'" in line


@pytest.mark.parametrize("camera", [{"serial": "999"}, {"model": "BFS-U3-51S5M"}, {"bit_depth": 10}])
def test_a_calibration_of_another_camera(run_failing, tmp_path, camera):
    """Neither another unit, another model nor another pixel format is measured with."""
    code, line = run_failing("measure", "--calibration", edited_calibration(tmp_path, **camera))
    assert code == 1
    assert str(next(iter(camera.values()))) in line


def test_a_patch_off_the_sensor(run_failing):
    """Misuse: the frame's size is named."""
    code, line = run_failing("measure", "--patch", "1600,0,40,40")
    assert code == 2
    assert "1616 × 1240" in line


def test_an_exposure_ladder_beyond_the_camera(run_failing, tmp_path):
    """Limits and unit are named."""
    code, line = run_failing("bracket", tmp_path / "out", "--from", "1us", "--to", "1ms")
    assert code == 1
    assert "allowed is 1.1e-05 to 30 s" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", ["", "a: b", "format: radiometer-calibration/9", "\x00\x01", "a: ["])
def test_a_file_that_is_no_calibration(run_failing, tmp_path, content):
    """Whatever the file holds, the message names it and there is no traceback."""
    (tmp_path / "c.yaml").write_text(content)
    code, line = run_failing("measure", "--calibration", tmp_path / "c.yaml")
    assert code == 1
    assert "c.yaml" in line
    assert "Traceback" not in line
