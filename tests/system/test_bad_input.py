"""Bad input to the main job's commands: one clear line, exit code 1 or 2, no traceback, nothing half-written."""

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


def edited_bench(tmp_path, change):
    """Write the simulated bench with a change."""
    mapping = yaml.safe_load(shipped_config("bench-simulated.yaml").read_text())
    change(mapping)
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return path


def test_a_bench_with_an_unknown_key(run_failing, tmp_path):
    """The key and what is allowed are named; misuse has exit code 2."""
    code, line = run_failing("measure", "--bench", edited_bench(tmp_path, lambda m: m.update(lenz=1)))
    assert code == 2
    assert "unknown key 'lenz'" in line


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
