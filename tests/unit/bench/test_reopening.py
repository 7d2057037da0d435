"""A camera that was lost is opened anew and set as it was before it is used again."""

from __future__ import annotations

from typing import Any

import pytest

from radiometer.bench.reopening import reopen
from radiometer.devices import CameraSettings
from radiometer.errors import DeviceLost, MissingLibrary


class LostCamera:
    """A camera that can be set only while it is open, and that is away for some tries."""

    def __init__(self, away: int) -> None:
        self.away, self.is_open, self.settings = away, True, CameraSettings(exposure_s=0.01)

    def close(self) -> None:
        self.is_open = False

    def open(self) -> None:
        if self.away:
            self.away -= 1
            raise DeviceLost("unplugged")
        self.is_open = True

    def configure(self, settings: CameraSettings) -> None:
        if not self.is_open:
            raise DeviceLost("not open")
        self.settings = settings


@pytest.mark.parametrize("away", [0, 2])
def test_a_camera_that_is_back_is_open_with_its_settings(away: int) -> None:
    """It is let go, opened again after as many pauses as it was away for, and only then set."""
    camera: Any = LostCamera(away)
    pauses: list[float] = []

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) > away:
            pytest.fail("a camera that is there is not opened")

    requested = CameraSettings(exposure_s=0.003)
    reopen(camera, requested, lambda _reason: None, pause)
    assert (camera.is_open, camera.settings, len(pauses)) == (True, requested, away)


def test_each_reason_is_reported_once_and_a_camera_that_does_not_open_is_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Who waits hears of a new reason and not of the same one again; between two tries nothing is held open."""
    reasons = ["unplugged", "unplugged", "in use", "in use"]
    camera: Any = LostCamera(0)
    plain_open = camera.open

    def fail_first() -> None:
        if reasons:
            camera.is_open = True  # an opening that fails half way
            raise DeviceLost(reasons.pop(0))
        plain_open()

    monkeypatch.setattr(camera, "open", fail_first)
    reported: list[str] = []
    held: list[bool] = []
    reopen(camera, CameraSettings(exposure_s=0.003), reported.append, lambda _s: held.append(camera.is_open))
    assert (reported, held, camera.is_open) == (["unplugged", "in use"], [False] * 4, True)


def test_a_camera_that_can_never_be_opened_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its library no pause helps: the error comes at the first try."""
    camera: Any = LostCamera(0)

    def fail() -> None:
        raise MissingLibrary("aravis")

    monkeypatch.setattr(camera, "open", fail)
    with pytest.raises(MissingLibrary):
        reopen(camera, CameraSettings(exposure_s=0.003), pytest.fail, pytest.fail)
