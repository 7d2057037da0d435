"""The watch on a camera knows by when a call should be over."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

from radiometer.daemon.watched_camera import WatchedCamera
from radiometer.devices import Camera, CameraSettings


class _Camera:
    """Notes what the watch says while a call runs."""

    def __init__(self) -> None:
        self.settings = CameraSettings(0.5)
        self.seen: list[float | None] = []
        self.watch: Any = None

    def capture(self, count: int = 1) -> list[Any]:
        self.seen.append(self.watch.late_at)
        return []

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self.seen.append(self.watch.late_at)
        raise ValueError("refused")


def test_a_capture_is_late_after_twice_its_exposures_and_a_grace() -> None:
    """1.4 s, counted from the call's begin; after the call nothing is late."""
    camera: Any = _Camera()
    camera.watch = watched = WatchedCamera(camera, clock=lambda: 100.0)
    watched.capture(3)
    assert camera.seen == [100.0 + 1.4 + 3.0]
    assert watched.late_at is None


def test_a_refused_call_is_not_late_for_ever() -> None:
    """An error ends the call too."""
    camera: Any = _Camera()
    camera.watch = watched = WatchedCamera(camera, clock=lambda: 100.0)
    try:
        watched.configure(CameraSettings(0.1))
    except ValueError:
        assert camera.seen == [100.0 + 1.4]
    assert watched.late_at is None


def test_it_is_a_camera() -> None:
    """It has every member of the Protocol."""
    assert [name for name in dir(Camera) if not name.startswith("_") and not hasattr(WatchedCamera, name)] == []


def test_every_call_reaches_the_camera_and_what_it_returns_comes_back() -> None:
    """Nothing is held back, exchanged or made up: each member is the camera's own, with the arguments given."""
    camera = MagicMock()
    watched: Any = WatchedCamera(camera)
    for name in ("identity", "capabilities", "settings", "description", "lens", "counts"):
        assert getattr(watched, name) is getattr(camera, name)
    wanted = CameraSettings(0.1)
    camera.settings = wanted
    assert watched.configure(wanted) is camera.configure.return_value
    assert watched.capture(2) is camera.capture.return_value
    assert watched.stream() is camera.stream.return_value
    watched.set_shutter(closed=True)
    with watched as entered:
        assert entered is watched
        camera.open.assert_called_once_with()
        camera.close.assert_not_called()
    camera.close.assert_called_once_with()
    camera.configure.assert_called_once_with(wanted)
    camera.capture.assert_called_once_with(2)
    camera.set_shutter.assert_called_once_with(closed=True)
