from __future__ import annotations

import ast
import sys
from types import SimpleNamespace

import pytest

from drivers import aravis_camera
from drivers.camera_finding import find_camera
from drivers.camera_quirks import quirks_for
from drivers.frame_assembly import assemble, holds_other_settings
from drivers.frame_stream import RawFrame
from radiometer.data import LensDescription
from radiometer.devices import CameraIdentity, CameraSettings
from radiometer.errors import DeviceError, DeviceNotFound, MissingLibrary

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


def test_without_pygobject_the_message_names_the_packages(library_to_be_loaded):
    """A hidden library is told by the packages that bring it, and importing the driver still works."""
    library_to_be_loaded.setitem(sys.modules, "gi", None)
    with pytest.raises(MissingLibrary, match=r"pip install 'radiometer\[genicam\]'"):
        aravis_camera.discover()


def test_without_aravis_the_message_names_the_debian_package(library_to_be_loaded):
    """PyGObject without Aravis's description is told by its Debian package."""

    def require_version(name: str, version: str) -> None:
        raise ValueError(f"Namespace {name} not available for version {version}")

    library_to_be_loaded.setitem(sys.modules, "gi", SimpleNamespace(require_version=require_version))
    with pytest.raises(MissingLibrary, match=r"gir1\.2-aravis-0\.8"):
        aravis_camera.open_camera("22500001")


def test_only_one_module_imports_the_library(project_root):
    """`gi` is imported in drivers/aravis_camera.py and nowhere else, and there not at module import."""
    importers = []
    for folder in ("radiometer", "drivers", "simulators"):
        for path in (project_root / folder).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for node in ast.walk(tree):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                if any(name.split(".")[0] == "gi" for name in names):
                    assert node not in tree.body, "imported when the module is"
                    importers.append(path.relative_to(project_root).as_posix())
    assert set(importers) == {"drivers/aravis_camera.py"}


@pytest.mark.parametrize("name", ["22500002", "FLIR-22500002-01"])
def test_a_camera_is_found_by_serial_number_or_id(name):
    """Serial number and device id mean the same camera."""
    assert find_camera(SimpleNamespace(), name, lambda: TWO).serial == "22500002"


def test_an_address_needs_no_discovery():
    """An address is used as it is; nothing is sent to the network to find it."""

    def never() -> list[CameraIdentity]:
        raise AssertionError("discovery was asked")

    assert find_camera(SimpleNamespace(), "127.0.0.1", never).device_id == "127.0.0.1"


def test_an_unknown_name_is_told_with_those_that_answer():
    """The message lists ids and serial numbers."""
    with pytest.raises(DeviceNotFound, match=r"no camera 7 answers.*FLIR-22500001-01 \(serial 22500001\)"):
        find_camera(SimpleNamespace(), "7", lambda: TWO)


def test_several_cameras_and_no_name_is_an_error():
    """Without a name there must be just one camera."""
    with pytest.raises(DeviceNotFound, match="several cameras answer; name one"):
        find_camera(SimpleNamespace(), None, lambda: TWO)


def raw_frame(**chunks: float) -> RawFrame:
    return RawFrame(b"\x01\x02", 0x01080001, 2, 1, 5, 12.5, chunks)


def test_a_chunk_of_another_exposure_marks_a_stale_frame():
    """Chunks decide whether a frame was exposed under the settings in force."""
    settings = CameraSettings(exposure_s=0.01, gain_db=6.0, pixel_format="Mono8")
    assert holds_other_settings(raw_frame(ExposureTime=20_000.0, Gain=6.0), settings)
    assert holds_other_settings(raw_frame(ExposureTime=10_000.0, Gain=0.0), settings)
    assert not holds_other_settings(raw_frame(ExposureTime=10_000.4, Gain=6.0), settings)
    assert not holds_other_settings(raw_frame(), settings)


def test_a_frame_carries_the_chunk_values():
    """Where the camera says under which exposure a frame was taken, the frame says it too."""
    settings = CameraSettings(exposure_s=0.01, pixel_format="Mono8")
    quirks = quirks_for("FLIR", "BFS-U3-19S4M")
    lens = LensDescription(f_number=4.0)
    frame = assemble(raw_frame(ExposureTime=10_000.4), settings, quirks, 8, lens, 41.0)
    assert frame.settings.exposure_s == pytest.approx(0.0100004, rel=1e-12)
    assert frame.settings.f_number == 4.0
    assert frame.settings.temperature_c == 41.0
    assert frame.extra == {"chunk_ExposureTime": 10_000.4}


def test_a_frame_of_another_format_is_refused():
    """A picture in a format other than the one set is not reinterpreted."""
    settings = CameraSettings(exposure_s=0.01, pixel_format="Mono12")
    with pytest.raises(DeviceError, match="sent Mono8 where Mono12 was set"):
        assemble(raw_frame(), settings, quirks_for("Aravis", "Fake"), 12, LensDescription(), None)
