"""Bench files and the cameras that they name."""

import sys
from contextlib import closing

import pytest
import yaml

from drivers.cameras.aravis_camera import load_library
from radiometer.bench.cameras import list_cameras, make_camera, open_camera
from radiometer.bench.config import read_bench
from radiometer.data.config_files import shipped_config
from radiometer.errors import ConfigurationError, MissingLibrary


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
        (lambda m: m["lens"].update(f_number=-1), r"lens\.f_number = -1: -1 is outside 0.5 to 1000"),
        (lambda m: m["camera"].update(kind="film"), r"camera.*'film'"),
        (lambda m: m.pop("lens"), "key 'lens' is missing"),
        (lambda m: m.update(format="radiometer-bench/9"), "format = 'radiometer-bench/9'"),
        (lambda m: m["camera"].update(preset="NO-SUCH"), "no shipped configuration"),
        (lambda m: m["scene"].update(kind="moon"), r"kind = 'moon': there is no such scene"),
        (lambda m: m["scene"].update(brightnes=1), "brightnes"),
        (lambda m: m.pop("scene"), "key 'scene' is missing"),
    ],
)
def test_a_bench_that_cannot_be_built_says_why(edited, change, message):
    """Key, value and what is allowed stand in one line; preset and scene are checked when the camera is made."""
    path = edited(change)
    with pytest.raises(ConfigurationError, match=message):
        make_camera(*read_bench(path))


@pytest.mark.parametrize("number", [20497219, "20497219", "0138C343"])
def test_a_serial_number_may_stand_as_a_number(edited, number):
    """Decimals as people write them, which YAML takes for a whole number, and hexadecimal digits as USB has them."""
    path = edited(lambda m: m.update(camera={"kind": "genicam", "id": number}))
    assert read_bench(path)[0].camera.id == str(number)


@pytest.fixture
def hidden_library(monkeypatch):
    """Hide PyGObject, as on a computer without it."""
    load_library.cache_clear()
    monkeypatch.setitem(sys.modules, "gi", None)
    yield
    load_library.cache_clear()


def test_without_the_library_the_simulated_camera_is_still_listed_and_works(hidden_library):
    """A missing library is reported next to the cameras that can be opened, not instead of them."""
    found, reason = list_cameras(*read_bench())
    assert [camera.device_id for camera in found] == ["sim"]
    assert "PyGObject" in reason
    with make_camera(*read_bench(), "sim") as camera:
        assert len(camera.capture(1)) == 1


def test_without_the_library_a_real_camera_is_an_error_that_names_the_packages(hidden_library):
    """Asking for a camera by serial number says what to install."""
    with pytest.raises(MissingLibrary, match="apt install"):
        make_camera(*read_bench(), "22500001")
