"""Cameras and benches that commands find, make or do without."""

import itertools
import json
import sys
from dataclasses import replace

import pytest
import yaml

import radiometer as rm
from drivers.cameras.aravis_camera import load_library
from radiometer.bench.config import read_bench
from radiometer.cli.main import run
from radiometer.data import LensDescription, Patch
from radiometer.devices import CameraPreset
from radiometer.errors import DeviceLost
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping


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
    assert run(["new-bench", str(tmp_path / "no-lens.yaml"), "--camera", "22500001"]) == 0
    assert read_bench(tmp_path / "no-lens.yaml")[0].lens is None  # no focal length: no lens is made up


@pytest.mark.slow
def test_a_simulated_bench_measures(tmp_path, capsys):
    """The file is taken by `measure` at once, before any calibration."""
    path = tmp_path / "bench.yaml"
    assert run(["new-bench", str(path), "--camera", "sim", "--patch", "800,600,20,20"]) == 0
    assert run(["measure", "--bench", str(path), "--uncalibrated", "--json"]) == 0
    assert '"uncalibrated"' in capsys.readouterr().out


@pytest.fixture
def hidden_library(monkeypatch):
    """Hide PyGObject, as on a computer without it."""
    load_library.cache_clear()
    monkeypatch.setitem(sys.modules, "gi", None)
    yield
    load_library.cache_clear()


def test_a_missing_library_and_a_camera_that_is_not_there_are_faults(hidden_library, capsys):
    """Without the library the doctor still runs, names the packages, and leaves with 1; the camera is a finding."""
    assert run(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "FAULT" in out
    assert "apt install" in out
    assert run(["doctor", "--camera", "4711", "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    last = printed["findings"][-1]
    assert (printed["sound"], last["check"], last["health"]) == (False, "camera", "fault")
    assert set(last) == {"check", "health", "message", "cure"}


PATCHES = [{"name": "lamp", "x": 40, "y": 20, "width": 20, "height": 10, "drive": 1.0}]

SCENE = {"kind": "screen", "peak_radiance_W_per_sr_m2": 2.0, "gamma": 2.2, "background": 1e-6, "patches": PATCHES}


class RealCamera(SimulatedCamera):
    """Stands in for the driver's camera: behind a lens, knowing only what the bench states."""

    lost_at = ()  # captures at which it is lost

    def __init__(self, lens: LensDescription) -> None:
        model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LensDescription(f_number=4.0))
        limits = replace(default_limits(), width=80, height=60)
        super().__init__(model, scene_from_mapping(SCENE), seed=3, limits=limits)
        self.stated, self.openings, self.frames = lens, 0, 0

    @property
    def lens(self) -> LensDescription:
        return self.stated

    def open(self) -> None:
        self.openings += 1
        super().open()

    def capture(self, count: int = 1):
        self.frames += 1
        if self.frames in self.lost_at:
            raise DeviceLost("camera FLIR 20497219 stopped answering")
        frames = super().capture(count)
        return [replace(frame, settings=replace(frame.settings, f_number=self.stated.f_number)) for frame in frames]


@pytest.fixture
def real(monkeypatch):
    """Have the driver find one camera under every name, and return the list of those that were made."""
    made: list[RealCamera] = []

    def find(name: str | None, preset=None, lens: LensDescription | None = None) -> RealCamera:
        made.append(RealCamera(lens or LensDescription()))
        return made[-1]

    monkeypatch.setattr("drivers.cameras.aravis_camera.open_camera", find)
    return made


def test_brackets_and_readings_without_a_bench_take_nothing_of_the_simulated_one(real, tmp_path, capsys):
    """Neither lens nor scale."""
    assert run(["bracket", str(tmp_path / "set"), "--camera", "20497219"]) == 0
    written = yaml.safe_load((tmp_path / "set" / "capture.yaml").read_text(encoding="utf-8"))
    assert "lens" not in written
    assert "source" not in written
    assert written["patches"] == []
    assert all("f_number" not in frame for frame in written["frames"])
    assert real[0].stated == LensDescription()
    assert run(["measure", "--camera", "20497219", "--patch", "42,22,8,6", "--json"]) == 0
    reading = json.loads(capsys.readouterr().out)
    assert "uncalibrated" in reading["flags"]


@pytest.mark.slow
def test_a_bracket_of_the_simulated_camera_keeps_its_bench(tmp_path):
    """`--camera sim` is the simulated bench: its lens is known and written."""
    assert run(["bracket", str(tmp_path / "set"), "--from", "1ms", "--to", "2ms", "--camera", "sim"]) == 0
    written = yaml.safe_load((tmp_path / "set" / "capture.yaml").read_text(encoding="utf-8"))
    assert written["lens"]["focal_length_mm"] == 16
    assert written["source"]["wavelength_nm"] == 550


def test_a_bracket_of_a_patch_speaks_of_the_patch_only(real, tmp_path, capsys):
    """Pixels outside the patch, which no one asked for, are neither counted nor complained of.

    A dark patch is reported to be dark, with the place it has in the frame.
    """
    words = ["--camera", "20497219", "--patch", "42,22,8,6"]
    assert run(["bracket", str(tmp_path / "set"), *words, "--json"]) == 0
    stated = json.loads(capsys.readouterr().out)
    assert (stated["pixels"], stated["well_exposed_twice"], stated["below_noise"]) == (48, 48, 0)
    assert run(["bracket", str(tmp_path / "again"), *words]) == 0
    printed = capsys.readouterr().err
    assert "100.00 % of the patch's pixels are well exposed" in printed
    assert "not reached" not in printed
    words = ["--camera", "20497219", "--patch", "2,40,6,4", "--from", "100us", "--to", "200us"]
    assert run(["bracket", str(tmp_path / "dark"), *words]) == 0
    printed = capsys.readouterr().err
    assert "24 of 24 pixels stay under the noise floor" in printed
    assert "(within x 2, y 40, 6 × 4)" in printed


def test_watching_survives_a_camera_that_comes_back(real, monkeypatch, capsys):
    """A camera lost in the second reading is opened anew, and its reading follows with the same number."""
    monkeypatch.setattr(RealCamera, "lost_at", (9,))
    stated: list[str] = []
    watched = rm.readings("20497219", (42, 22, 8, 6), watch=True, notice=stated.append, sleep=lambda _seconds: None)
    assert [reading.sequence for reading in itertools.islice(watched, 3)] == [1, 2, 3]
    assert real[0].openings == 2
    assert any("stopped answering; waiting for it" in line for line in stated)
    assert stated[-1].endswith("is back")
    monkeypatch.setattr(RealCamera, "lost_at", (1,))  # a single reading of a camera that is lost fails
    assert run(["measure", "--camera", "20497219", "--patch", "42,22,8,6"]) == 1
    assert "stopped answering" in capsys.readouterr().err
