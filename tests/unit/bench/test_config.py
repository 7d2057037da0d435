"""Bench files: validated, with errors that name key, value and what is allowed."""

from __future__ import annotations

from contextlib import closing

import pytest
import yaml

from radiometer.bench.cameras import make_camera, open_camera
from radiometer.bench.config import read_bench
from radiometer.data.config_files import shipped_config
from radiometer.errors import ConfigurationError


@pytest.fixture
def edited(tmp_path):
    """Return a function that writes the shipped simulated bench with a change and returns its path."""

    def write(change):
        mapping = yaml.safe_load(shipped_config("bench-simulated.yaml").read_text())
        change(mapping)
        path = tmp_path / "bench.yaml"
        path.write_text(yaml.safe_dump(mapping))
        return path

    return write


def test_the_shipped_bench_opens():
    """Camera, lens and scene fit; settings are as the file says."""
    with closing(open_camera(*read_bench())) as camera:
        assert camera.settings.black_level_dn == 64
        assert camera.lens.f_number == 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(lense={}), r"unknown key 'lense'; allowed here: calibration, camera"),
        (
            lambda m: m["lens"].update(focal_lenght_mm=1),
            r"unknown key 'lens\.focal_lenght_mm'; allowed here:.*focal_length",
        ),
        (lambda m: m["lens"].update(f_number=-1), r"lens\.f_number = -1: input should be greater than 0"),
        (lambda m: m["camera"].update(kind="film"), r"camera.*'film'"),
        (lambda m: m.pop("lens"), "key 'lens' is missing"),
        (lambda m: m.update(format="radiometer-bench/9"), "format = 'radiometer-bench/9'"),
    ],
)
def test_what_is_not_allowed_is_named(edited, change, message):
    """Key, value and what is allowed stand in one line."""
    with pytest.raises(ConfigurationError, match=message):
        read_bench(edited(change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["camera"].update(preset="NO-SUCH"), "no shipped configuration"),
        (lambda m: m["scene"].update(kind="moon"), r"kind = 'moon': there is no such scene"),
        (lambda m: m["scene"].update(brightnes=1), "brightnes"),
        (lambda m: m.pop("scene"), "key 'scene' is missing"),
    ],
)
def test_a_bench_that_cannot_be_built_says_why(edited, change, message):
    """Preset and scene are checked when the camera is made."""
    config, where = read_bench(edited(change))
    with pytest.raises(ConfigurationError, match=message):
        make_camera(config, where)


@pytest.mark.parametrize("number", [20497219, "20497219", "0138C343"])
def test_a_serial_number_may_stand_as_a_number(edited, number):
    """Decimals as people write them, which YAML takes for a whole number, and hexadecimal digits as USB has them."""
    path = edited(lambda m: m.update(camera={"kind": "genicam", "id": number}))
    assert read_bench(path)[0].camera.id == str(number)
