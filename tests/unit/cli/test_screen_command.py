"""`radiometer screen`: files, JSON, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import radiometer as rm
from radiometer.cli.main import run
from radiometer.screen import ScreenCalibration
from radiometer.screen.calibration import LUMINANCE


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file that `screen calibrate --quick` makes of the simulated OLED."""
    file = tmp_path_factory.mktemp("screen") / "oled.yaml"
    assert run(["screen", "calibrate", "--display", "oled", "--quick", "-o", str(file), "--export", "csv,ti3"]) == 0
    return file


@pytest.mark.slow
def test_calibrate_writes_calibration_and_exports(calibration):
    """The file reads back with seven levels; the exports is next to it."""
    assert ScreenCalibration.read(calibration).channel().levels == (0, 32, 64, 96, 128, 192, 255)
    assert calibration.with_suffix(".csv").exists()
    assert calibration.with_suffix(".ti3").exists()


def test_level_answers_in_json(calibration, capsys):
    """Level and what it shows with uncertainty, near the target."""
    assert run(["screen", "level", str(calibration), "50", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["shown"]["value"] == pytest.approx(50, abs=0.5)
    assert answer["shown"]["u"] > 0


@pytest.mark.slow
def test_level_out_of_reach_fails_in_one_line(calibration, capsys):
    """Exit code 1, the limits in the message."""
    assert run(["screen", "level", str(calibration), "5000"]) == 1
    assert "allowed is" in capsys.readouterr().err


@pytest.mark.slow
def test_export_names_what_it_wrote(calibration, tmp_path, capsys):
    """Every kind asked for is written into the folder."""
    assert run(["screen", "export", str(calibration), "psychopy,vcgt", "-o", str(tmp_path)]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"oled.json", "oled.vcgt"}


@pytest.mark.parametrize(
    "words",
    [
        ["screen", "calibrate", "--display", "plasma"],
        ["screen", "calibrate", "--display", "oled", "--levels", "few"],
        ["screen", "calibrate", "--display", "oled", "--export", "xlsx"],
        ["screen", "calibrate", "--display", "oled", "--channels", "gray"],
    ],
)
def test_misuse_is_exit_code_two(words, tmp_path, capsys):
    """A wrong word is named and nothing is written."""
    assert run([*words, "-o", str(tmp_path / "x.yaml")]) == 2
    assert capsys.readouterr().err.startswith("error:")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_json_and_argyll_speak_for_programs(tmp_path, capsys):
    """--json is one object; --argyll prints a line of spotread's for every level."""
    options = ["--display", "oled", "--levels", "0,128,255", "-o", str(tmp_path / "o.yaml")]
    assert run(["screen", "calibrate", *options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["format"] == "radiometer-screen/1"
    assert run(["screen", "calibrate", *options, "--argyll", "--force"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith(" Result is XYZ:")]
    assert len(lines) == 3


@pytest.mark.slow
def test_own_export_is_imported_and_a_kept_calibration_is_verified(calibration, tmp_path):
    """The CSV gives the luminances back to its six digits; the OLED agrees with itself, the LCD does not."""
    back = rm.screen_import(calibration.with_suffix(".csv"), tmp_path / "back.yaml")
    known = ScreenCalibration.read(calibration).channel()
    for level in known.levels[1:]:
        assert back.calibration.channel().at(level, LUMINANCE).value == pytest.approx(
            known.at(level, LUMINANCE).value, rel=1e-5
        )
    assert run(["screen", "verify", str(calibration), "--display", "oled", "--levels", "0,128,255"]) == 0
    assert run(["screen", "verify", str(calibration), "--display", "lcd", "--levels", "0,128,255"]) == 1


@pytest.mark.parametrize("words", [["calibrate", "-o", "x.yaml"], ["verify", "CALIBRATION"]])
def test_real_screen_needs_a_real_camera(words, calibration, tmp_path, monkeypatch):
    """Without --camera or --bench a browser's page is not measured by the simulated camera; nothing is written."""
    monkeypatch.chdir(tmp_path)
    assert run(["screen", *(str(calibration) if word == "CALIBRATION" else word for word in words)]) == 2
    assert list(tmp_path.iterdir()) == []
