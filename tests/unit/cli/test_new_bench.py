"""`radiometer new-bench`: a file that the other commands take, or one line why not."""

from __future__ import annotations

import pytest

from radiometer.bench.config import read_bench
from radiometer.cli.main import run
from radiometer.data import Patch


def test_a_real_camera_and_its_lens(tmp_path):
    """What was answered stands in the file, what was not is left open."""
    path = tmp_path / "bench.yaml"
    words = ["--camera", "0138C343", "--focal-length", "16", "--f-number", "2.8", "--patch", "10,20,30,40"]
    assert run(["new-bench", str(path), *words]) == 0
    config, _ = read_bench(path)
    assert (config.camera.kind, config.camera.id) == ("genicam", "0138C343")
    assert (config.lens.focal_length_mm, config.lens.f_number) == (16.0, 2.8)
    assert config.patch.patch == Patch(10, 20, 30, 40)
    assert config.calibration is None
    assert config.scene is None


def test_a_lens_of_which_nothing_is_known_stays_unknown(tmp_path):
    """No focal length: no lens is made up."""
    path = tmp_path / "bench.yaml"
    assert run(["new-bench", str(path), "--camera", "22500001"]) == 0
    assert read_bench(path)[0].lens is None


@pytest.mark.slow
def test_a_simulated_bench_measures(tmp_path, capsys):
    """The file is taken by `measure` at once, before any calibration."""
    path = tmp_path / "bench.yaml"
    assert run(["new-bench", str(path), "--camera", "sim", "--patch", "800,600,20,20"]) == 0
    assert run(["measure", "--bench", str(path), "--uncalibrated", "--json"]) == 0
    assert '"uncalibrated"' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "needs a camera"),
        (["--camera", "1", "--focal-length", "16"], "needs its f-number"),
        (["--camera", "1", "--focal-length", "-3"], "expected a number above 0"),
        (["--camera", "1", "--patch", "1,2,3"], "expected X,Y,W,H"),
    ],
)
def test_what_cannot_be_a_bench_is_misuse_and_leaves_no_file(tmp_path, capsys, words, message):
    """Exit code 2, one line, nothing written."""
    path = tmp_path / "bench.yaml"
    assert run(["new-bench", str(path), *words]) == 2
    assert message in capsys.readouterr().err
    assert not path.exists()
