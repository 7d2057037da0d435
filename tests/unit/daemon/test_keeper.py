"""What a kept device leaves behind when a call to it fails, and when a late one is called late."""

from __future__ import annotations

import asyncio
import gc
import threading
import time
import weakref
from types import SimpleNamespace

import pytest

from radiometer.daemon import keeper as keeper_module
from radiometer.daemon.alarms import Alarms
from radiometer.daemon.instrument import DeviceReport
from radiometer.daemon.keeper import DeviceKeeper, DeviceState, KeeperTimes
from radiometer.daemon.patience import Patience
from radiometer.errors import DeviceLost
from testing.patience import within


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


class SlowDevice:
    """A device that answers when it is told to, and says that it is late at once."""

    def __init__(self) -> None:
        self.late_at: float | None = None
        self.may_answer = threading.Event()

    def open(self) -> None:
        """Open at once."""

    def close(self) -> None:
        """Close nothing."""

    def check(self) -> DeviceReport:
        """Answer at once."""
        return DeviceReport()

    def ask(self) -> None:
        """Answer once it is allowed to."""
        self.may_answer.wait(within(20.0))


class ClingingDevice(SlowDevice):
    """A device that closes once it is allowed to."""

    closed = False

    def close(self) -> None:
        """Let go when told, or after a while."""
        self.may_answer.wait(within(2.0))
        self.closed = True


async def test_a_device_that_does_not_let_go_keeps_nobody_from_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the time that it has the daemon ends without it: the call is left behind in its thread."""
    device = ClingingDevice()
    keeper = DeviceKeeper("camera", device, Alarms(lambda *_: None))
    await keeper.open_once()
    asked_s: list[float] = []

    def impatient(seconds: float) -> asyncio.Timeout:
        asked_s.append(seconds)
        return asyncio.timeout(0.01)

    monkeypatch.setattr(keeper_module, "asyncio", SimpleNamespace(**{**vars(asyncio), "timeout": impatient}))
    await keeper.close()
    assert (device.closed, keeper.state, asked_s) == (False, DeviceState.CLOSED, [5.0])
    device.may_answer.set()


async def test_late_answers_do_not_make_the_alarm_flap() -> None:
    """Late and timely answers by turns are one alarm, not many; two timely ones in a row end it."""
    told: list[str] = []
    device, alarms = SlowDevice(), Alarms(lambda kind, name, message: told.append(kind))
    keeper = DeviceKeeper("camera", device, alarms)
    keeper._patience = Patience(lambda: 0.0)
    await keeper.open_once()

    async def late() -> None:
        device.may_answer.clear()
        device.late_at = time.monotonic() - 5.0  # later than any patience
        asking = asyncio.create_task(keeper.use(device.ask))
        while keeper._called_late_at is None:
            await asyncio.sleep(0.005)
        device.may_answer.set()
        await asking
        device.late_at = None

    for _ in range(3):
        await late()
        await keeper.use(device.ask)
        assert keeper.state is DeviceState.OVERDUE
    assert told == ["alarm"]
    await keeper.use(device.ask)
    assert (keeper.state, told) == (DeviceState.READY, ["alarm", "cleared"])
    await keeper.close()


@pytest.mark.parametrize(
    ("own_word_s", "overdue_s", "usual_s", "late"),
    [
        (None, 30.0, 0.0, False), (None, -30.0, 0.0, True), (None, -30.0, 40.0, False), (30.0, -30.0, 0.0, False),
        (-30.0, 60.0, 0.0, True),
    ],
)  # fmt: skip
async def test_a_call_is_late_by_the_device_s_own_word_or_by_what_is_usual(
    monkeypatch: pytest.MonkeyPatch, own_word_s: float | None, overdue_s: float, usual_s: float, late: bool
) -> None:
    """Where the device says by when, that counts; else half as much again as usual and what is granted beyond it."""
    monkeypatch.setattr(keeper_module, "_LOOK_S", 0.001)
    device, alarms = SlowDevice(), Alarms(lambda *_: None)
    keeper = DeviceKeeper("camera", device, alarms)
    await keeper.open_once()
    keeper._times = KeeperTimes(overdue_s=overdue_s)
    device.may_answer.clear()
    device.late_at = None if own_word_s is None else time.monotonic() + own_word_s
    asking = asyncio.create_task(keeper.use(device.ask, usual_s=usual_s))
    async with asyncio.timeout(within(10.0)):
        while late and keeper._called_late_at is None:
            await asyncio.sleep(0.001)
    for _ in range(10):
        await asyncio.sleep(0.001)
    assert keeper.state is (DeviceState.OVERDUE if late else DeviceState.READY)
    assert len(alarms.active) == late
    device.may_answer.set()
    await asking
    await keeper.close()


@pytest.mark.slow
async def test_time_in_which_the_daemon_itself_stood_still_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that slept 30 s where 0.2 s were meant calls nobody late for that."""
    device, alarms = SlowDevice(), Alarms(lambda *_: None)
    keeper = DeviceKeeper("camera", device, alarms)
    await keeper.open_once()
    shift, wait = [0.0], asyncio.wait
    monkeypatch.setattr(keeper_module, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + shift[0]))

    async def stand_still(futures: object, timeout: float) -> object:
        outcome = await wait(futures, timeout=timeout)  # type: ignore[type-var, arg-type]
        shift[0] += 30.0
        if shift[0] > 200.0:
            device.may_answer.set()
        return outcome

    device.late_at = time.monotonic() + 25.0
    monkeypatch.setattr(keeper_module.asyncio, "wait", stand_still)
    await keeper.use(device.ask)
    monkeypatch.undo()
    assert alarms.active == ()
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
