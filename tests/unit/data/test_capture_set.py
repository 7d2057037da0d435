"""Capture sets: what is written is read, and what is unfinished or inconsistent is refused with its reason."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest
import yaml

from radiometer.data import CameraDescription, CaptureSet, CaptureSetWriter, Frame, FrameSettings
from radiometer.errors import CaptureError

PORT = {"name": "port", "x": 0, "y": 0, "width": 2, "height": 2}
STATISTIC = {"exposure_s": 0.01, "mean_dn": 100.0, "variance_dn2": 40.0, "pixels": 48}
CAMERA = CameraDescription(bit_depth=12, model="BFS-U3-19S4M", serial="22500001")


def frame(level=100, exposure_s=0.01, shape=(6, 8), **settings):
    """Return a uniform 12-bit frame."""
    return Frame(np.full(shape, level, np.uint16), 12, FrameSettings(exposure_s, **settings))


@pytest.fixture
def capture(tmp_path):
    """Return the folder of a finished capture set of three light frames and a dark one."""
    folder = tmp_path / "capture"
    with CaptureSetWriter(folder, CAMERA) as writer:
        for exposure_s, level in ((0.04, 400), (0.01, 100), (0.02, 4095)):
            writer.add(frame(level, exposure_s, temperature_c=41.5, black_level_dn=64.0))
        writer.add(frame(64, 0.04, shutter="closed"))
    return folder


def edit(folder, change):
    """Change capture.yaml through a function of its mapping."""
    path = folder / "capture.yaml"
    mapping = yaml.safe_load(path.read_text())
    change(mapping)
    path.write_text(yaml.safe_dump(mapping))


def test_digital_numbers_and_settings_survive_the_disk(capture):
    """A 12-bit 4095 is stored as 4095; settings come back as they were."""
    read = CaptureSet.read(capture)
    frames = list(read.frames())
    assert [int(f.dn[0, 0]) for f in frames] == [400, 100, 4095, 64]
    assert frames[0].settings == FrameSettings(0.04, black_level_dn=64.0, temperature_c=41.5)
    assert frames[3].settings.is_dark


def test_keys_of_other_programs_are_kept(capture):
    """Unknown keys are allowed and stay."""
    edit(capture, lambda m: m.update(laboratory={"room": 12}))
    assert CaptureSet.read(capture).header.to_mapping()["laboratory"] == {"room": 12}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["camera"].pop("bit_depth"), r"'camera.bit_depth' is missing"),
        (lambda m: m["frames"][1].update(exposure_s=-1), r"frames\.1\.exposure_s = -1"),
        (lambda m: m["frames"][1].update(file="frames/9999.png"), r"9999\.png' does not exist"),
        (lambda m: m["frames"][1].update(file="../../etc/passwd"), "outside the capture set"),
        (lambda m: m["frames"][1].update(file="a" * 5000), "'aaa+' is not a file name"),
        (lambda m: m["frames"][1].update(file="a\0.png"), "is not a file name"),
        (lambda m: m.update(format="radiometer-capture/9"), "this version reads"),
        (lambda m: m.update(frames=[]), "frames is missing or empty"),
        (lambda m: m["frames"][1].update(exposure_s=0), "shutter: closed"),
        (lambda m: m["frames"][1].update(shutter="ajar"), r"frames\.1\.shutter"),
        (lambda m: m["frames"][1].update(source_level=-0.1), r"source_level = -0\.1"),
        (lambda m: m["frames"][1].update(f_number=0), "f_number = 0"),
        (lambda m: m["frames"][1].update(photons=-1), "photons = -1"),
        (lambda m: m.update(patches=[PORT, PORT]), "patch name 'port' occurs twice"),
        (lambda m: m.update(patches=[PORT | {"width": 0}]), r"patches\.0\.width = 0"),
        (lambda m: m.update(patches=[PORT | {"x": -1}]), r"patches\.0\.x = -1"),
        (lambda m: m.update(frames=[], statistics=[STATISTIC]), "statistics of settings and no pictures"),
        (lambda m: m.update(frames=[], statistics=[STATISTIC | {"clipped_share": 1.1}]), r"clipped_share = 1\.1"),
    ],
)
def test_a_wrong_header_is_refused_with_key_and_reason(capture, change, message):
    """The error names the file, the key and what is wrong."""
    edit(capture, change)
    with pytest.raises(CaptureError, match=message):
        CaptureSet.read(capture)


def test_text_that_is_no_yaml_is_refused_with_its_line(capture):
    """The error gives line and column."""
    (capture / "capture.yaml").write_text("camera: {bit_depth: 12\nframes: ]")
    with pytest.raises(Exception, match="line 2"):
        CaptureSet.read(capture)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.full((6, 8), 5000, np.uint16), "holds the value 5000, above the full scale 4095"),
        (np.full((5, 8), 50, np.uint16), r"0001\.png: is 8 × 5 pixels, the frames before 8 × 6"),
        (np.zeros((6, 8, 3), np.uint16), "expected one channel"),
    ],
)
def test_frames_that_contradict_the_header_or_each_other_are_refused(capture, picture, message):
    """All have one size and one channel, and numbers of as many bits as stated; the error names the file."""
    cv2.imwrite(str(capture / "frames" / "0001.png"), picture)
    with pytest.raises(CaptureError, match=message):
        list(CaptureSet.read(capture).frames())


@pytest.mark.parametrize(
    ("remove", "message"),
    [
        (("capture.yaml", "frames"), "it is no capture set"),
        (("capture.yaml", "frames", ""), "does not exist"),
        (("frames/0002.png",), r"0002\.png' does not exist; the capture set is incomplete"),
    ],
)
def test_a_folder_that_lacks_something_is_refused(capture, remove, message):
    """Nothing of a capture, no folder at all, one frame less: each is stated, and none is read as fewer frames."""
    for name in remove:
        target = capture / name
        shutil.rmtree(target) if target.is_dir() else target.unlink()
    with pytest.raises(CaptureError, match=message):
        CaptureSet.read(capture)


def test_a_bias_frame_needs_no_time(capture):
    """An exposure of 0 s with the shutter closed is read out at once: it is a dark frame."""
    edit(capture, lambda m: m["frames"][3].update(exposure_s=0))
    assert CaptureSet.read(capture).read_frame(3).settings.is_dark


def test_a_file_that_is_no_picture_is_refused(capture):
    """Damaged and missing files are distinguished, each by its name."""
    (capture / "frames" / "0001.png").write_bytes(b"\x89PNG" + bytes(200) + b"IEND")
    read = CaptureSet.read(capture)
    with pytest.raises(CaptureError, match=r"0001\.png: .*damaged"):
        read.read_frame(1)
    (capture / "frames" / "0001.png").unlink()
    with pytest.raises(CaptureError, match=r"cannot read frame .*0001\.png: No such file"):
        read.read_frame(1)
