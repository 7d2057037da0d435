"""The driver on a bad line, in simulated time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from radiometer.devices import CurrentRange, DriveLevel
from radiometer.devices.exposure_account import MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import DeviceError, DeviceLost
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.virtual_line import LineFaults, VirtualLine

CHANNELS = ("bleach", "spot", "spot_red", "fixation")
OPTICS = {name: ChannelOptics(640.0, 18.0, 1.5, 1.0) for name in CHANNELS}


def bench(seed: int, **faults: float) -> tuple[SimulatedLightBox, VirtualLine, SerialLightBox]:
    """Return a twin, its line and an unopened driver."""
    rng = np.random.default_rng(seed)
    twin = SimulatedLightBox(SimulatedBoxSettings())
    line = VirtualLine(twin, LineFaults(**faults, rng=rng), latency_s=0.0003, rng=rng)
    return (
        twin,
        line,
        SerialLightBox(
            BoxLink(line, _sequence=0), ExposureLedger(OPTICS, MemoryStore(line.now, ("TWIN0001",))), keep_alive=False
        ),
    )


@pytest.mark.long
def test_ten_thousand_commands_on_a_line_with_one_percent_wrong_bytes():
    """No wrong level is ever set, and none is reported as done that was not."""
    twin, line, box = bench(11, corrupt=0.01)
    box.open()
    rng = np.random.default_rng(12)
    asked: set[tuple[str, int, bool]] = set()
    driven: set[tuple[str, int, bool]] = set()
    twin.watch = lambda: driven.update((c.limits.name, c.driven_level, c.high) for c in twin.channels if c.driven_level)
    done = failed = 0
    for _ in range(10_000):
        name = CHANNELS[rng.integers(4)]
        drive = DriveLevel(int(rng.integers(1, 20_000)), list(CurrentRange)[rng.integers(2)])
        asked.add((name, drive.level, drive.current_range is CurrentRange.HIGH))
        try:
            state = box.set_level(name, drive)
        except DeviceError:
            failed += 1
            box.close()
            box.open()
            continue
        done += 1
        channel = twin.channels[CHANNELS.index(name)]
        assert (channel.driven_level, channel.high) == (drive.level, drive.current_range is CurrentRange.HIGH)
        assert state.drive == drive
    assert driven <= asked
    assert done >= 9_990  # 16 attempts of which 6 in 10 succeed: far less than one failure is expected
    assert line.faults.touched > 10_000


@pytest.mark.parametrize("faults", [{"drop": 0.01}, {"insert": 0.01}, {"corrupt": 0.015}])
def test_other_damage_is_survived_too(faults):
    """Lost, invented and more wrong bytes cost time, never a wrong level."""
    twin, _, box = bench(13, **faults)
    box.open()
    for level in range(1, 200):
        assert box.set_level("spot", DriveLevel(level)).drive.level == level
        assert twin.channels[1].driven_level == level


def test_restart_is_noticed_and_reported():
    """A box that restarts while lit: the next command says so, and opening again gives a dark box."""
    twin, line, box = bench(14)
    box.open()
    box.set_level("spot", DriveLevel(30_000))
    line.wait(0.1)
    twin.reset("B")
    with pytest.raises(DeviceLost, match=r"restarted|gone dark"):
        box.set_level("spot", DriveLevel(30_000))
    box.close()
    box.open()
    assert twin.duty("spot") == 0
    assert box.status().reset_cause == "brown-out"


def test_restart_is_noticed_where_its_announcement_is_lost():
    """A restart whose boot line never arrives is seen from the box's clock running backwards."""
    twin, line, box = bench(15)
    box.open()
    line.wait(0.5)
    twin.reset("W")
    twin.emitted.clear()
    with pytest.raises(DeviceLost, match="restarted"):
        box.tend()


def test_light_that_ended_with_the_session_is_not_counted_on():
    """After a restart the retinal account holds only what was given, not a light that goes on for ever."""
    optics = {name: ChannelOptics(453.0, 22.0, 1.5, 8.0) for name in CHANNELS}
    twin, line, box = bench(19)
    box.ledger.optics = optics
    box.open()
    box.set_level("spot", DriveLevel(60_000))  # 7 % of the blue-light limit if it stayed on
    twin.reset("E")
    with pytest.raises(DeviceLost):
        box.set_level("spot", DriveLevel(60_000))
    box.close()
    line.wait(0.1)
    box.open()
    assert box.set_level("spot_red", DriveLevel(60_000)).drive.level == 60_000


def test_silence_of_the_host_is_reported_to_it():
    """A host that slept for more than a second is notified that the box went dark."""
    twin, line, box = bench(16)
    box.open()
    box.set_level("spot", DriveLevel(30_000))
    line.wait(1.5)
    assert twin.duty("spot") == 0
    with pytest.raises(DeviceLost, match="gone dark"):
        box.set_level("spot", DriveLevel(30_000))


def test_button_events_lost_on_the_line_are_fetched():
    """With one line in three damaged every press still comes, once and in order."""
    twin, line, box = bench(17, corrupt=0.012)
    box.open()
    start_s = line.now()
    for press in range(40):
        twin.press(start_s + 0.2 + 0.5 * press)
        twin.press(start_s + 0.3 + 0.5 * press, pressed=False)
    events = list(box.buttons(22.0))
    assert [event.pressed for event in events] == [True, False] * 40
    assert all(late.time_s > early.time_s for early, late in pairwise(events))


@pytest.mark.long
def test_press_times_over_forty_minutes_with_a_fast_clock():
    """Button times err by less than 2 ms, and by less than their stated k = 2, at 200 ppm over 40 minutes."""
    rng = np.random.default_rng(18)
    twin = SimulatedLightBox(SimulatedBoxSettings(clock_ppm=200.0))
    line = VirtualLine(twin, latency_s=0.0008, least_latency_s=0.0002, rng=rng)
    box = SerialLightBox(
        BoxLink(line, _sequence=0), ExposureLedger(OPTICS, MemoryStore(line.now, ("TWIN0001",))), keep_alive=False
    )
    box.open()
    presses_s = line.now() + 1.0 + np.cumsum(rng.uniform(1.0, 7.0, 590))
    for press_s in presses_s:
        twin.press(float(press_s))
        twin.press(float(press_s) + 0.2, pressed=False)
    found = [event for event in box.buttons(2400.0) if event.pressed]
    times_s = presses_s[: len(found)]
    errors_s = np.array([event.time_s for event in found]) - times_s
    stated_s = 2 * np.array([event.u_time_s for event in found])
    assert presses_s[-1] > 2200
    assert len(found) == np.count_nonzero(presses_s < line.now() - 0.1)
    assert np.abs(errors_s).max() < 2e-3
    assert stated_s.max() < 2e-3
    assert np.mean(np.abs(errors_s) <= stated_s) >= 0.95
    assert box.synchronise().drift_ppm == pytest.approx(200.0, abs=5.0)
