import ast
import gc
import re
import sys
from types import SimpleNamespace

import pytest

from drivers.cameras import aravis_camera
from drivers.cameras.aravis_camera import assemble
from drivers.cameras.camera_opening import find_camera
from drivers.cameras.camera_quirks import quirks_for
from drivers.cameras.frame_stream import RawFrame, holds_other_settings
from radiometer.data import LensDescription
from radiometer.devices import CameraIdentity, CameraSettings
from radiometer.errors import DeviceNotFound, MissingLibrary

TWO = [
    CameraIdentity("FLIR", "BFS-U3-19S4M", "22500001", "FLIR-22500001-01"),
    CameraIdentity("FLIR", "BFS-U3-19S4M", "22500002", "FLIR-22500002-01"),
]


@pytest.fixture
def library_to_be_loaded(monkeypatch):
    """Forget a library loaded earlier, and load it anew afterwards."""
    aravis_camera.load_library.cache_clear()
    yield monkeypatch
    aravis_camera.load_library.cache_clear()


def _require_version(name: str, version: str) -> None:
    raise ValueError(f"Namespace {name} not available for version {version}")


@pytest.mark.parametrize(
    ("library", "message"),
    [
        (None, r"pip install 'radiometer\[genicam\]'"),
        (SimpleNamespace(require_version=_require_version), r"gir1\.2-aravis-0\.8"),
    ],
    ids=["PyGObject", "its description of Aravis"],
)
def test_what_is_not_installed_is_named_by_its_package(library_to_be_loaded, library, message):
    """Importing the driver still works without either."""
    library_to_be_loaded.setitem(sys.modules, "gi", library)
    for use in (aravis_camera.discover, lambda: aravis_camera.open_camera("22500001")):
        with pytest.raises(MissingLibrary, match=message):
            use()


OWNERS = {
    "gi": "drivers/cameras/aravis_camera.py",
    "linuxpy": "drivers/cameras/v4l2_link.py",
    "picamera2": "drivers/cameras/pi_link.py",
    "gphoto2": "drivers/cameras/tethered_link.py",
}


@pytest.mark.slow
def test_only_one_module_imports_each_library(project_root):
    """Each camera library is imported in its own module and nowhere else, and there not at module import."""
    importers = {library: set() for library in OWNERS}
    for folder in ("radiometer", "drivers", "simulators"):
        for path in (project_root / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not re.search(rf"\b({'|'.join(OWNERS)})\b", text):
                continue
            gc.disable()  # a finaliser run within the parser is an error of CPython 3.11
            tree = ast.parse(text)
            gc.enable()
            for node in ast.walk(tree):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                if isinstance(node, ast.Call) and ast.unparse(node.func) == "required_library":
                    names += [ast.literal_eval(node.args[0])]
                for library in {name.split(".")[0] for name in names} & OWNERS.keys():
                    assert node not in tree.body, "imported when the module is"
                    importers[library].add(path.relative_to(project_root).as_posix())
    assert importers == {library: {owner} for library, owner in OWNERS.items()}


USB = [
    CameraIdentity("FLIR", "BFS-U3-19S4M", "0138C343", "FLIR-1E100138C343-0138C343", "USB3Vision"),
    CameraIdentity("FLIR", "BFS-U3-19S4M", "0138C344", "FLIR-1E100138C344-0138C344", "USB3Vision"),
]


@pytest.mark.parametrize(
    ("name", "serial"),
    [*((n, "0138C343") for n in ("0138C343", "0138c343", "20497219", "FLIR-1E100138C343-0138C343")),
     *((n, "22500002") for n in ("22500002", "FLIR-22500002-01"))],
)  # fmt: skip
def test_a_camera_is_found_by_id_and_by_any_notation_of_its_number(name, serial):
    """USB reports the number in hexadecimal, its label and people in decimal: both mean the same camera."""
    assert find_camera(SimpleNamespace(), name, lambda: TWO + USB).serial == serial


def test_an_address_needs_no_discovery():
    """An address is used as it is; nothing is sent to the network to find it."""

    def never() -> list[CameraIdentity]:
        raise AssertionError("discovery was asked")

    assert find_camera(SimpleNamespace(), "127.0.0.1", never).device_id == "127.0.0.1"


@pytest.mark.parametrize(
    ("name", "there", "message"),
    [
        ("7", TWO, r"no camera 7 answers.*FLIR-22500001-01 \(serial 22500001\)"),
        ("20497218", USB, r"serial 0138C344 \(20497220\)"),
        (None, TWO, "several cameras answer; name one"),
    ],
)
def test_an_unknown_name_or_none_of_several_is_reported_with_those_that_answer(name, there, message):
    """The message lists ids and serial numbers, those of USB in both notations."""
    with pytest.raises(DeviceNotFound, match=message):
        find_camera(SimpleNamespace(), name, lambda: there)


def raw_frame(**chunks: float) -> RawFrame:
    return RawFrame(b"\x01\x02", 0x01080001, 2, 1, 5, 12.5, chunks)


def test_a_chunk_of_another_exposure_marks_a_stale_frame():
    """Chunks decide whether a frame was exposed under the settings in force."""
    settings = CameraSettings(exposure_s=0.01, gain_db=6.0, pixel_format="Mono8")
    assert holds_other_settings(raw_frame(ExposureTime=20_000.0, Gain=6.0), settings)
    assert holds_other_settings(raw_frame(ExposureTime=10_000.0, Gain=0.0), settings)
    assert not holds_other_settings(raw_frame(ExposureTime=10_000.4, Gain=6.0), settings)
    assert not holds_other_settings(raw_frame(), settings)


@pytest.mark.parametrize(
    ("set_us", "chunk_us", "step_s", "is_other"),
    [
        (11.4, 11.0, 0.0, False),
        (11.4, 12.0, 0.0, False),
        (11.0, 12.0, 0.0, True),
        (12.0, 11.0, 0.0, True),
        (11.4, 14.0, 5e-6, False),
        (11.4, 17.0, 5e-6, True),
    ],
    ids=["rounded down", "rounded up", "one more", "one less", "within a coarse step", "beyond a coarse step"],
)
def test_a_chunk_is_compared_to_the_cameras_own_step(set_us, chunk_us, step_s, is_other):
    """At 11.4 µs a chunk in whole µs is 4 % off and still the same setting; a whole step away is another one."""
    settings = CameraSettings(exposure_s=set_us * 1e-6, pixel_format="Mono8")
    assert holds_other_settings(raw_frame(ExposureTime=chunk_us), settings, step_s) is is_other


def test_a_frame_carries_the_chunk_values():
    """A frame says under which exposure it was taken; 11.4 µs of a register are believed before a chunk of 11 µs."""
    settings = CameraSettings(exposure_s=0.01, pixel_format="Mono8")
    quirks = quirks_for("FLIR", "BFS-U3-19S4M")
    lens = LensDescription(f_number=4.0)
    frame = assemble(raw_frame(ExposureTime=10_000.4), settings, quirks, 8, lens, 41.0)
    assert frame.settings.exposure_s == pytest.approx(0.0100004, rel=1e-12)
    assert frame.settings.f_number == 4.0
    assert frame.settings.temperature_c == 41.0
    assert frame.extra == {"chunk_ExposureTime": 10_000.4}
    settings = CameraSettings(exposure_s=11.4e-6, pixel_format="Mono8")
    quirks, lens = quirks_for("FLIR", "BFS-U3-19S4M"), LensDescription()
    exposures = [
        assemble(raw_frame(ExposureTime=chunk_us), settings, quirks, 8, lens, None).settings.exposure_s
        for chunk_us in (11.0, 11.25, 14.0)
    ]
    assert exposures == pytest.approx([11.4e-6, 11.25e-6, 14e-6], rel=1e-12)
