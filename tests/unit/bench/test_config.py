"""Bench files and the cameras that they name."""

import sys
from contextlib import closing

import pytest
import yaml

import radiometer as rm
from drivers.cameras.aravis_camera import load_library
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.bench.cameras import list_cameras, make_camera, open_camera
from radiometer.bench.config import read_bench
from radiometer.data.storage import shipped_config
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
        (
            lambda m: m.update(camera={"kind": "genicam", "serial": "4711"}),
            r"unknown key 'camera\.serial'; allowed here: black_level_dn, gain_db, id, kind",
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
    """A missing library is reported next to the cameras that can be opened; for a real one it is an error."""
    found, reason = list_cameras(*read_bench())
    assert [camera.device_id for camera in found] == ["sim"]
    assert "PyGObject" in reason
    with make_camera(*read_bench(), "sim") as camera:
        assert len(camera.capture(1)) == 1
    with pytest.raises(MissingLibrary, match="apt install"):
        make_camera(*read_bench(), "22500001")


# What a bench or a capture states of its light is the light that is read.


PATCH = (10, 10, 16, 16)
BENCH = {
    "format": "radiometer-bench/1",
    "camera": {
        "kind": "simulated", "preset": "BFS-U3-19S4M", "serial": "22500001", "width": 64, "height": 48,
        "black_level_dn": 64,
    },
    "lens": {"focal_length_mm": 16, "f_number": 4},
    "scene": {"kind": "uniform", "radiance_W_per_sr_m2": 1.0},
}  # fmt: skip


@pytest.fixture
def readings(tmp_path):
    """Return a function that reads 1 W·sr⁻¹·m⁻² of a line at 600 nm live and from a capture set, and calibrates."""

    def read(**asked):
        bench = tmp_path / "bench.yaml"
        bench.write_text(yaml.safe_dump(BENCH | {"source": {"kind": "led", "wavelength_nm": 600}}))
        rm.bracket(tmp_path / "set", bench=bench, patch=PATCH)
        stated = {"patch": PATCH, "radiance": 1.0, "u_rel": 0.005}
        made = rm.calibrate(tmp_path / "set", **stated).calibration
        white = rm.calibrate(tmp_path / "set", spectrum="white_led", **stated).calibration
        white.write(tmp_path / "white.yaml")
        live = rm.measure(bench=bench, patch=PATCH, calibration=tmp_path / "white.yaml", **asked)
        return made, live, rm.measure_photographs(tmp_path / "set", PATCH, calibration=tmp_path / "white.yaml", **asked)

    return read


def test_a_stated_wavelength_is_the_light_of_readings_and_of_a_scale(readings):
    """683 lm/W · V(600 nm) relates radiance and luminance, not the efficacy of the white light of the calibration."""
    made, *found = readings()
    assert made.spectrum == made.scale.spectrum == "line:600"
    for reading in found:
        assert reading.luminance.value / reading.radiance.value == pytest.approx(683.0 * 0.631, rel=2e-3)
        assert "spectrum line:600" in reading.more["assumptions"]


def test_a_spectrum_that_is_asked_for_comes_before_the_wavelength(readings):
    """A user knows the light better than a bench file."""
    _, *found = readings(spectrum="display_green")
    for reading in found:
        efficacy = luminous_efficacy_lm_per_w(spectrum("display_green"), "photopic")
        assert reading.luminance.value / reading.radiance.value == pytest.approx(efficacy, rel=1e-6)
