"""Capture plans: taken in their order, each frame with what was staged for it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import yaml

from radiometer.acquire.capture_plan import CapturePlan, take_capture_plan
from radiometer.cli.main import run
from radiometer.data import CaptureSet, LensDescription
from radiometer.devices import CameraPreset
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.scenes.factory import scene_from_mapping

PLAN = {
    "format": "radiometer-plan/1",
    "reasons": ["separates exposure_time_offset from parasitic_light_sensitivity"],
    "frames": [
        {"exposure_s": 0.01, "gain_db": 6.0, "repeat": 2},
        {"exposure_s": 0.02, "shutter": "closed", "repeat": 1},
        {"exposure_s": 0.04, "source_level": 0.5, "f_number": 8.0},
    ],
}


@pytest.fixture
def plan_file(tmp_path):
    """Return a function that writes a plan."""

    def write(**changes):
        path = tmp_path / "plan.yaml"
        path.write_text(yaml.safe_dump({**PLAN, **changes}))
        return path

    return write


@pytest.mark.slow
def test_a_plan_is_taken_as_it_stands(plan_file, tmp_path):
    """Order, repeats, gain, shutter, source level and f-number are those of the plan, and so is the light."""
    assert run(["bracket", str(tmp_path / "out"), "--plan", str(plan_file())]) == 0
    frames = list(CaptureSet.read(tmp_path / "out").frames())
    settings = [frame.settings for frame in frames]
    assert [s.exposure_s for s in settings] == [0.01, 0.01, 0.02, 0.04]
    assert [s.gain_db for s in settings] == [6.0, 6.0, 0.0, 0.0]
    assert [s.shutter for s in settings] == ["open", "open", "closed", "open"]
    assert (settings[3].source_level, settings[3].f_number) == (0.5, 8.0)
    # Dark: the black level and under one DN of dark current; 2 million pixels average the noise away.
    assert frames[2].dn.mean() == pytest.approx(64.0, abs=0.1)
    # Patch "middle": gain 6 dB at 10 ms and f/4 against 0 dB at 40 ms, half the light and f/8 (a quarter of it).
    bright, dim = (frames[k].dn[240:360, 840:960].mean() - 64.0 for k in (0, 3))
    assert bright / dim == pytest.approx(10 ** (6 / 20) / (4 * 0.5 * 0.25), rel=0.01)


def small_camera():
    preset = CameraPreset.shipped("BFS-U3-19S4M").camera
    model = CameraModel.ideal(preset, LensDescription(focal_length_mm=16, f_number=4.0))
    limits = replace(default_limits(), width=40, height=30)
    return SimulatedCamera(model, scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.1}), limits=limits)


def test_every_frame_is_staged_and_set_as_planned():
    """Each entry is staged once before its frames, which have its exposure, gain, level, shutter and number."""
    planned, staged = CapturePlan.model_validate(PLAN), []
    with small_camera() as camera:
        frames = [frame.settings for frame in take_capture_plan(camera, planned, staged.append)]
    assert [one.exposure_s for one in staged] == [0.01, 0.02, 0.04]
    assert (planned.total, [s.exposure_s for s in frames]) == (4, pytest.approx([0.01, 0.01, 0.02, 0.04], rel=1e-3))
    assert [s.gain_db for s in frames] == pytest.approx([6.0, 6.0, 0.0, 0.0])
    assert [s.shutter for s in frames] == ["open", "open", "closed", "open"]
    assert [s.source_level for s in frames] == [1.0, 1.0, 1.0, 0.5]


def test_a_frame_is_filed_under_the_f_number_that_was_staged():
    """A lens set by hand is not known to the camera: the plan's f-number stands in the frame all the same."""
    planned = CapturePlan.model_validate({**PLAN, "frames": [{"exposure_s": 0.01, "f_number": 8.0}]})
    with small_camera() as camera:
        (frame,) = take_capture_plan(camera, planned, stage=lambda planned: None)
    assert frame.settings.f_number == 8.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": []}, "frames"),
        ({"frames": [{"exposure_s": -1}]}, "exposure_s = -1"),
        ({"format": "radiometer-plan/7"}, "radiometer-plan/7"),
    ],
)
def test_a_wrong_plan_is_misuse(plan_file, tmp_path, capsys, changes, message):
    """Key and value are named; nothing is written."""
    assert run(["bracket", str(tmp_path / "out"), "--plan", str(plan_file(**changes))]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
