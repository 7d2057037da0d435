"""What a kept device leaves behind when a call to it fails, and when a late one is called late."""

import asyncio
import contextlib
import gc
import weakref

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.instrument import DeviceReport
from radiometer.daemon.keeper import DeviceKeeper, DeviceState, KeeperTimes, Patience
from radiometer.errors import (
    DeviceError,
    DeviceInUse,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    MeasurementError,
    MissingLibrary,
    SettingOutOfRange,
)
from testing.patience import within


def test_patience_grows_by_what_came_late_and_fades():
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


TIMES = KeeperTimes(first_pause_s=0.1, longest_pause_s=0.75, check_every_s=0.02, overdue_s=50.0)


class Device:
    """A device that is there or not; notes what is done to it."""

    late_at = None

    def __init__(self, *, there=True):
        self.there, self.calls, self.reports = there, [], 0
        self.check_error = None

    def open(self):
        self.calls.append("open")
        if not self.there:
            raise DeviceNotFound("nothing there")

    def close(self):
        self.calls.append("close")

    def check(self):
        self.calls.append("check")
        if self.check_error is not None:
            raise self.check_error
        self.reports += 1
        return DeviceReport(float(self.reports))

    def work(self, error=None):
        self.calls.append("work")
        if error is not None:
            raise error
        return "done"


class Bench:
    """A keeper whose sleeps are counted and take no time."""

    def __init__(self, device, times=TIMES):
        self.device, self.slept, self.opened, self.checked, self.notified = device, [], 0, [], []
        self.alarms = Alarms(lambda *_: None)
        self.keeper = DeviceKeeper(
            "camera", device, self.alarms, times=times, sleep=self._sleep,
            after_open=self._after_open, after_check=self.checked.append,
        )  # fmt: skip

    async def _sleep(self, seconds):
        self.slept.append(seconds)
        await asyncio.sleep(0)

    def _after_open(self):
        self.opened += 1

    @property
    def alarm(self):
        return "; ".join(alarm.message for alarm in self.alarms.active)


@contextlib.asynccontextmanager
async def running(bench):
    """Run a keeper's loop while the test looks on."""
    task = asyncio.create_task(bench.keeper.run())
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        await bench.keeper.close()


class LibraryObject:
    """What a driver holds of its library: at its end it talks to the camera."""

    def answer(self):
        raise OSError("timeout")


async def test_failed_call_keeps_nothing_of_the_device():
    """What the call had in hand is freed when it fails, not at the next garbage collection."""
    bench, held = Bench(Device()), []

    def fail():
        half_open = LibraryObject()
        held.append(weakref.ref(half_open))
        try:
            half_open.answer()
        except OSError as error:
            raise DeviceLost("stopped answering") from error

    bench.device.open = fail
    gc.disable()
    try:
        assert not await bench.keeper.open_once()
        assert [one() for one in held] == [None]
    finally:
        gc.enable()
        await bench.keeper.close()


async def test_a_device_that_is_not_there_is_closed_again_and_an_alarm():
    """Lost, one loss however often it is tried, the reason in the alarm, nothing half open."""
    bench = Bench(Device(there=False))
    assert not await bench.keeper.open_once()
    assert not await bench.keeper.open_once()
    assert bench.device.calls == ["open", "close", "open", "close"]
    assert (bench.keeper.state, bench.keeper.losses, bench.opened) == (DeviceState.LOST, 1, 0)
    assert bench.alarm == "camera lost: nothing there; trying to reopen it"
    with pytest.raises(DeviceLost, match="nothing there"):
        await bench.keeper.use(bench.device.work)
    assert "work" not in bench.device.calls
    bench.device.there = True
    assert await bench.keeper.open_once()
    assert (bench.alarm, bench.keeper.losses, bench.opened) == ("", 1, 1)
    await bench.keeper.close()


async def test_a_loss_is_acted_on_at_once():
    """With questions an hour apart, a device that a call loses is opened again without waiting for the next."""
    bench = Bench(Device(), KeeperTimes(first_pause_s=0.1, longest_pause_s=0.75, check_every_s=3600.0, overdue_s=50.0))
    async with running(bench), asyncio.timeout(within(20.0)):
        while not bench.keeper.is_ready:
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.001)  # the loop waits for its next question by now
        with pytest.raises(DeviceLost):
            await bench.keeper.use(bench.device.work, DeviceLost("unplugged"))
        while bench.opened < 2:
            await asyncio.sleep(0.001)
        assert bench.device.calls == ["open", "check", "work", "open", "check"]


@pytest.mark.parametrize(
    ("error", "raised", "lost"),
    [
        *((kind("x"), kind, True) for kind in (DeviceLost, DeviceTimeout, DeviceNotFound, DeviceInUse, MissingLibrary)),
        (OSError("x"), DeviceLost, True), (ValueError("x"), DeviceLost, True), (DeviceError("x"), DeviceError, False),
        (MeasurementError("x"), MeasurementError, False),
        (SettingOutOfRange("c", "gain", 1.0, 0.0, 0.5, "dB"), SettingOutOfRange, False),
    ],
)  # fmt: skip
async def test_which_errors_are_a_loss(error, raised, lost):
    """What says that the device is gone; a wrong setting or a dark scene does not; a bug is reported as a loss."""
    bench = Bench(Device())
    await bench.keeper.open_once()
    with pytest.raises(raised) as caught:
        await bench.keeper.use(bench.device.work, error)
    assert type(caught.value) is raised
    assert (bench.keeper.is_ready, bench.keeper.losses, "camera lost" in bench.alarm) == (not lost, lost, lost)
    if not lost:
        assert await bench.keeper.use(bench.device.work) == "done"
    assert bench.keeper.stuck_s == 0.0
    await bench.keeper.close()


async def test_pauses_double_up_to_the_longest_and_start_anew(eventually):
    """0.1, 0.2, 0.4, 0.75, 0.75 s; after it was there, 0.1 again."""
    bench = Bench(Device(there=False))
    async with running(bench):
        await eventually(lambda: len(bench.slept) >= 6)
        assert bench.slept[:6] == [0.1, 0.2, 0.4, 0.75, 0.75, 0.75]
        bench.device.there = True
        await eventually(lambda: bench.keeper.is_ready)
        await asyncio.sleep(0.05)
        before = len(bench.slept)
        bench.device.there, bench.device.check_error = False, DeviceLost("unplugged")
        await eventually(lambda: len(bench.slept) >= before + 2)
        assert bench.slept[before : before + 2] == [0.1, 0.2]
        assert bench.keeper.losses == 2


async def test_an_idle_device_is_asked_and_its_report_handed_on(eventually):
    """Every check's report reaches whoever waits for it; a loss that shows there is one."""
    bench = Bench(Device())
    async with running(bench):
        await eventually(lambda: len(bench.checked) >= 3)
        values = [report.temperature_c for report in bench.checked]
        assert values == sorted(values)
        assert bench.keeper.report.temperature_c >= values[-1]
        bench.device.check_error = DeviceError("a passing trouble")
        asked = bench.device.calls.count("check")
        await eventually(lambda: bench.device.calls.count("check") > asked + 1)
        assert bench.keeper.is_ready
        bench.device.check_error, bench.device.there = DeviceLost("unplugged"), False
        await eventually(lambda: bench.keeper.state is DeviceState.LOST)
        bench.device.check_error, bench.device.there = None, True
        await eventually(lambda: bench.keeper.is_ready)
        assert bench.opened == 2


async def test_calls_come_one_after_the_other():
    """Two at once are two in a row, on one thread."""
    bench = Bench(Device())
    await bench.keeper.open_once()
    inside = []

    def slow(number):
        inside.append(number)
        assert len(inside) == 1
        inside.clear()
        return number

    assert await asyncio.gather(*(bench.keeper.use(slow, number) for number in range(20))) == list(range(20))
    await bench.keeper.close()


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from(["open", "work", "lose", "plug", "unplug", "mute", "heal"]), max_size=12))
def test_states_follow_what_happens(steps):
    """In any order: ready while the last opening held and its question was answered, an alarm exactly while lost."""

    async def play():
        bench, ready, losses, lost, opened = Bench(Device()), False, 0, False, 0
        assert bench.keeper.state is DeviceState.CLOSED
        for step in steps:
            if step in ("plug", "unplug"):
                bench.device.there = step == "plug"
            elif step in ("mute", "heal"):
                bench.device.check_error = DeviceTimeout("no answer") if step == "mute" else None
            elif step == "open":
                ready, begun = await bench.keeper.open_once(), len(bench.device.calls)
                assert ready is (bench.device.there and bench.device.check_error is None)
                assert bench.device.calls[begun - 1] == ("check" if ready else "close")
                losses, lost, opened = losses + (not ready and not lost), not ready, opened + ready
                assert not ready or bench.keeper.report == DeviceReport(float(bench.device.reports))
            else:
                error = DeviceLost("gone") if step == "lose" else None
                if ready and error is None:
                    assert await bench.keeper.use(bench.device.work) == "done"
                else:
                    with pytest.raises(DeviceLost):
                        await bench.keeper.use(bench.device.work, error)
                    losses += ready
                    lost, ready = lost or ready, False
            shown = (bench.keeper.is_ready, bench.keeper.losses, bool(bench.alarm), bench.opened)
            assert shown == (ready, losses, lost, opened)
        await bench.keeper.close()
        assert bench.keeper.state is DeviceState.CLOSED

    asyncio.run(play())


def test_an_alarm_is_reported_when_it_goes_up_becomes_worse_and_goes_down():
    """Its time stays and its message is the newest; what is not up is not taken down; the oldest stands first."""
    notified = []
    alarms = Alarms(lambda *what: notified.append(what))
    alarms.put_up("camera", "late")
    alarms.put_up("journal", "full")
    since = alarms.active[0].since
    alarms.put_up("camera", "later")
    alarms.put_up("camera", "lost", worse=True)
    assert [(one.name, one.message, one.announced) for one in alarms.active] == [
        ("camera", "lost", 2), ("journal", "full", 1),
    ]  # fmt: skip
    assert alarms.active[0].since == since
    alarms.clear("camera", "camera is back")
    alarms.clear("camera", "camera is back")
    assert notified == [
        ("alarm", "camera", "late"), ("alarm", "journal", "full"), ("changed", "camera", "lost"),
        ("cleared", "camera", "camera is back"),
    ]  # fmt: skip
    assert [one.name for one in alarms.active] == ["journal"]
