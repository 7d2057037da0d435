"""What a kept device leaves behind when a call to it fails, and when a late one is called late."""

from __future__ import annotations

import gc
import weakref

import pytest

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.instrument import DeviceReport
from radiometer.daemon.keeper import DeviceKeeper, Patience
from radiometer.errors import DeviceLost


class LibraryObject:
    """What a driver holds of its library: at its end it talks to the camera."""

    def answer(self) -> None:
        """Fail as the library does."""
        raise OSError("timeout")


class BrokenDevice:
    """A device that is lost while it is being opened."""

    late_at = None

    def __init__(self) -> None:
        self.held: list[weakref.ref[LibraryObject]] = []

    def open(self) -> None:
        """Take something of the library in hand and fail."""
        half_open = LibraryObject()
        self.held.append(weakref.ref(half_open))
        try:
            half_open.answer()
        except OSError as error:
            raise DeviceLost("stopped answering") from error

    def close(self) -> None:
        """Close nothing."""

    def check(self) -> DeviceReport:
        """Return an empty report."""
        return DeviceReport()


@pytest.fixture
def broken() -> BrokenDevice:
    """Return a device that cannot be opened."""
    return BrokenDevice()


async def test_failed_call_keeps_nothing_of_the_device(broken: BrokenDevice) -> None:
    """What the call had in hand is freed when it fails, not at the next garbage collection."""
    keeper = DeviceKeeper("camera", broken, Alarms(lambda *_: None))
    gc.disable()
    try:
        assert not await keeper.open_once()
        assert [held() for held in broken.held] == [None]
    finally:
        gc.enable()
        await keeper.close()


def test_patience_grows_by_what_came_late_and_fades() -> None:
    """Half as much again as the lateness, half of that a minute later, never more than 3 s; luck resets nothing."""
    now = [100.0]
    patience = Patience(lambda: now[0])
    assert patience.extra_s == 0.0
    patience.was_late(0.4)
    assert patience.extra_s == pytest.approx(0.6)
    now[0] += 60.0
    assert patience.extra_s == pytest.approx(0.3)
    patience.was_late(100.0)
    assert patience.extra_s == 3.0
    assert [patience.was_on_time(), patience.was_on_time()] == [False, True]
    patience.was_late(0.0)
    assert not patience.was_on_time()
