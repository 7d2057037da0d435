from __future__ import annotations

import sys

import pytest

from drivers.cameras.aravis_camera import load_library
from radiometer.bench.cameras import list_cameras, make_camera
from radiometer.bench.config import read_bench
from radiometer.errors import MissingLibrary


@pytest.fixture
def hidden_library(monkeypatch):
    """Hide PyGObject, as on a computer without it."""
    load_library.cache_clear()
    monkeypatch.setitem(sys.modules, "gi", None)
    yield
    load_library.cache_clear()


def test_without_the_library_the_simulated_camera_is_still_listed(hidden_library):
    """A missing library is reported next to the cameras that can be opened, not instead of them."""
    found, reason = list_cameras(*read_bench())
    assert [camera.device_id for camera in found] == ["sim"]
    assert reason is not None
    assert "PyGObject" in reason


def test_without_the_library_a_real_camera_is_an_error_that_names_the_packages(hidden_library):
    """Asking for a camera by serial number says what to install."""
    with pytest.raises(MissingLibrary, match="apt install"):
        make_camera(*read_bench(), "22500001")


def test_without_the_library_the_simulated_camera_still_works(hidden_library):
    """Everything else runs: the simulated camera opens and captures."""
    with make_camera(*read_bench(), "sim") as camera:
        assert len(camera.capture(1)) == 1
