"""Flicker from a camera's fast series, on a simulated light whose modulation is known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import radiometer as rm
from radiometer.cli.main import run

BENCH = """\
format: radiometer-bench/1
camera: {{kind: simulated, preset: BFS-U3-19S4M, serial: "22500001", seed: {seed}, width: 96, height: 64,
         black_level_dn: 64, flicker: {{frequency_Hz: {hz}, modulation: {depth}}}}}
lens: {{focal_length_mm: 16, f_number: 4}}
scene: {{kind: uniform, radiance_W_per_sr_m2: 0.4}}
patch: {{x: 32, y: 30, width: 32, height: 2}}
"""


def _bench(folder: Path, seed: int, hz: float, depth: float) -> Path:
    file = folder / f"bench{seed}.yaml"
    file.write_text(BENCH.format(seed=seed, hz=hz, depth=depth))
    return file


@pytest.mark.slow
def test_sine_of_known_modulation_is_covered(tmp_path: Path) -> None:
    """Over 8 seeds, frequency and SVM of a sine are within k·u in 93 %, within chance (6 of 8 or more)."""
    inside = {"frequency": 0, "svm": 0}
    for seed in range(8101, 8109):
        depth, hz = 0.1 + 0.05 * (seed % 7), 90.0 + 3.7 * (seed % 11)
        found = rm.flicker(bench=_bench(tmp_path, seed, hz, depth), duration=0.25).measures
        svm = depth / (2.865e-5 * hz**1.543 + 0.225)  # Perz et al. 2018: one component
        assert found.frequency is not None
        assert found.svm is not None
        inside["frequency"] += abs(found.frequency.value - hz) <= found.coverage_factor * found.frequency.u
        inside["svm"] += abs(found.svm.value - svm) <= found.coverage_factor * found.svm.u
    assert min(inside.values()) >= 6, inside


def test_long_exposure_is_reported_as_averaging(tmp_path: Path) -> None:
    """An exposure of 2 ms leaves sinc(0.2) = 94 % of 100 Hz; the result warns of it."""
    found = rm.flicker(bench=_bench(tmp_path, 8120, 100.0, 0.3), duration=0.3, exposure=2e-3).measures
    assert any("94 %" in warning for warning in found.warnings)


def test_command_prints_rate_and_measure_flags_the_light(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`flicker --bench` is JSON with the frame rate's limit; `measure` of the same light has the flag `flicker`."""
    bench = _bench(tmp_path, 8130, 137.0, 0.5)  # no exposure made for mains light averages it
    assert run(["flicker", "--bench", str(bench), "--duration", "0.3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["frequency"]["value"] == pytest.approx(137.0, abs=0.5)
    assert any("wrong frequency" in line for line in found["assumptions"])
    run(["measure", "--bench", str(bench), "--uncalibrated", "--json"])
    assert "flicker" in json.loads(capsys.readouterr().out)["flags"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "--camera"),
        (["lamp.csv", "--camera", "sim"], "no file"),
        (["--camera", "sim", "--duration", "0"], "above 0"),
        (["--camera", "sim", "--dark", "0.1"], "no file"),
    ],
)
def test_misuse_is_one_line(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    """What contradicts is named, exit code 2."""
    assert run(["flicker", *words]) == 2
    assert expected in capsys.readouterr().err
