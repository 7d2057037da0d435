from __future__ import annotations

import cv2
import numpy as np
import pytest

from radiometer.bench.served_camera import served_camera
from radiometer.cli.main import run
from radiometer.errors import ConfigurationError


@pytest.mark.parametrize(
    ("words", "code", "shown"),
    [
        (["--help"], 0, "camera"),
        ([], 2, "camera"),
        (["camrea"], 2, "'camera'"),
        (["camera", "--scene", "no/none.yaml"], 2, "none.yaml"),
    ],
)
def test_devices_are_listed_and_what_is_not_there_is_reported(capsys, words, code, shown):
    """A mistyped device gets a hint; a missing scene is one line."""
    assert run(["simulate", *words]) == code
    printed = capsys.readouterr()
    assert shown in printed.out + printed.err


def test_a_scene_with_an_unknown_kind_is_refused(tmp_path):
    """The message names the file and the kinds that there are."""
    file = tmp_path / "scene.yaml"
    file.write_text("kind: moonlight\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"scene\.yaml.*moonlight"):
        served_camera(scene=str(file))


def test_only_a_simulated_bench_can_be_served(tmp_path):
    """A bench with a real camera has nothing to serve."""
    file = tmp_path / "bench.yaml"
    file.write_text(
        "format: radiometer-bench/1\ncamera: {kind: genicam, id: '1'}\nlens: {focal_length_mm: 16, f_number: 4}\n",
        encoding="utf-8",
    )
    with pytest.raises(ConfigurationError, match="only a simulated one can be served"):
        served_camera(file)


@pytest.mark.parametrize("kind", ["uniform", "screen", "led"])
def test_a_kind_of_scene_can_be_named(kind):
    """A scene that needs nothing reported is named by its kind."""
    assert served_camera(scene=kind, serial="5").label == "simulated camera FLIR BFS-U3-19S4M 5"


def test_a_picture_can_be_the_scene(tmp_path):
    """A picture file is a scene of its own."""
    file = tmp_path / "scene.png"
    cv2.imwrite(str(file), np.full((20, 30), 128, np.uint8))
    assert served_camera(scene=str(file)).label


def test_the_awkward_camera_has_a_hexadecimal_number_unless_one_is_given():
    """It is known by model and number; those of the bench are not its own."""
    assert served_camera(awkward=True).label == "simulated camera FLIR Blackfly S BFS-PGE-19S4M 0138C343"
    assert served_camera(awkward=True, serial="0138C344").label.endswith("0138C344")
