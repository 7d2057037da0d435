"""Contract of every light box, simulated or with real firmware, also on a line with noise."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from drivers.light_box.serial_line import SerialLine
from radiometer.devices import ChannelMode, CurrentRange, DriveLevel, LightBox, Radiance
from radiometer.errors import CalibrationError, DeviceError, DeviceInUse, DeviceLost, SettingOutOfRange, UsageError
from testing.patience import within

DUTY_TOLERANCE = 0.004  # an 8 ms window cuts one of its 62 or 125 PWM periods somewhere


def test_it_is_a_light_box_and_dark_after_opening(rig):
    """The whole protocol, dark after opening; supply and temperature within the steps of the ADC (20 mV, 0.5 °C)."""
    assert isinstance(rig.box, LightBox)
    assert rig.box.identity.protocol_version == 2
    assert list(rig.box.channels) == ["bleach", "spot", "spot_red", "fixation", "spot_green", "field"]
    assert [rig.duty(name) for name in rig.box.channels] == [0] * 6
    assert all(rig.box.read_channel(name).mode is ChannelMode.OFF for name in rig.box.channels)
    time.sleep(0.1)
    status = rig.box.status()
    assert status.supply_v == pytest.approx(12.0, abs=0.04)
    assert status.temperature_celsius == pytest.approx(25.0, abs=0.6)


@pytest.mark.parametrize("channel", ["bleach", "spot", "spot_red"])
def test_level_reaches_the_pin_and_is_read_back(rig, channel):
    """It is read back as set, the pin's duty is the stated step; on the low range the high-current switch is open."""
    rig.box.set_level(channel, DriveLevel(40000, CurrentRange.LOW))
    assert rig.wait_until(lambda: rig.duty(channel) > 0.5)
    assert not rig.high_current(channel)
    state = rig.box.set_level(channel, DriveLevel(23456))
    assert (state.mode, state.drive) == (ChannelMode.STEADY, DriveLevel(23456, CurrentRange.HIGH))
    expected = state.duty_steps / rig.box.channels[channel].duty_steps
    assert rig.box.channels[channel].duty(23456) == expected
    assert rig.wait_until(lambda: abs(rig.duty(channel) - expected) < DUTY_TOLERANCE)
    assert rig.high_current(channel)


def test_pulse_ends_by_itself(rig):
    """A pulse is timed by the box: the host says nothing more and the channel is dark afterwards."""
    state = rig.box.pulse("spot", DriveLevel(50000), 0.4)
    assert state.mode is ChannelMode.PULSE
    assert rig.wait_until(lambda: rig.duty("spot") > 0.7)
    assert rig.wait_until(lambda: rig.duty("spot") == 0)
    assert rig.box.read_channel("spot").mode is ChannelMode.OFF


def test_blink_train_ends_after_its_count(rig):
    """Three blinks are three; then the channel is off."""
    rig.box.blink("spot_red", DriveLevel(30000), on_s=0.06, off_s=0.06, count=3)
    rises, before, deadline_s = 0, False, time.monotonic() + within(5)
    while time.monotonic() < deadline_s:
        now = rig.duty("spot_red") > 0.2
        rises, before = rises + (now and not before), now
        if rises and rig.box.read_channel("spot_red").mode is ChannelMode.OFF:
            break
    assert rises <= 3  # polling may miss one on a busy machine, never add one
    assert rig.box.read_channel("spot_red").mode is ChannelMode.OFF


def test_ramp_arrives_and_stays(rig):
    """A ramp ends at its target and becomes steady."""
    rig.box.ramp("spot", DriveLevel(20000), 0.2)
    assert rig.wait_until(lambda: rig.box.read_channel("spot").mode is ChannelMode.STEADY)
    assert rig.box.read_channel("spot").drive == DriveLevel(20000)


def test_off_darkens_one_channel_only(rig):
    """Darkening a channel leaves the others; after safe() every pin is low."""
    rig.box.set_level("spot", DriveLevel(30000))
    rig.box.set_level("spot_red", DriveLevel(30000))
    rig.box.off("spot")
    assert rig.wait_until(lambda: rig.duty("spot") == 0)
    assert rig.duty("spot_red") > 0.4
    rig.box.off("spot_red")
    for name in ("field", "spot", "spot_green", "fixation"):
        rig.box.set_level(name, DriveLevel(10000))
    rig.box.safe()
    assert rig.wait_until(lambda: all(rig.duty(name) == 0 for name in rig.box.channels))


def test_light_stays_on_while_the_host_lives(rig):
    """The driver keeps the dead-man timer fed without the caller's help."""
    rig.box.set_level("spot", DriveLevel(30000))
    time.sleep(1.6)
    assert rig.duty("spot") > 0.4
    assert rig.box.status().darkened == 0


def test_button_press_and_release_are_reported_in_order(rig):
    """A press and its release come as two events with growing times."""
    rig.press(True)
    time.sleep(0.05)
    rig.press(False)
    events = list(rig.box.buttons(0.5))
    assert [event.pressed for event in events] == [True, False]
    assert events[0].time_s < events[1].time_s
    assert events[1].number == events[0].number + 1


def test_what_cannot_be_set_is_refused_and_changes_nothing(rig):
    """A level above the limit, by the box too where the host's check is circumvented; another channel; a radiance."""
    with pytest.raises(DeviceError, match="above its limit"):
        rig.box.link.request("SL 3 H 20001")
    assert rig.box.read_channel("fixation").mode is ChannelMode.OFF
    assert rig.duty("fixation") == 0
    rig.box.set_level("fixation", DriveLevel(1000, CurrentRange.LOW))
    with pytest.raises(SettingOutOfRange, match="allowed is 0 to 20000"):
        rig.box.set_level("fixation", DriveLevel(20001))
    assert rig.box.read_channel("fixation").drive == DriveLevel(1000, CurrentRange.LOW)
    with pytest.raises(UsageError, match="it has bleach, spot, spot_red, fixation"):
        rig.box.set_level("green", DriveLevel(1))
    with pytest.raises(CalibrationError, match="light calibrate"):  # which names the way out
        rig.box.set_level("spot", Radiance(0.01))


def test_second_program_is_refused_because_the_box_is_in_use(rig):
    """The port is held exclusively."""
    other = SerialLightBox(BoxLink(SerialLine(rig.server.port)), rig.box.ledger)
    with pytest.raises(DeviceInUse, match="another program"):
        other.open()


def test_pulled_cable_is_a_lost_device_and_plugging_in_helps(rig):
    """Unplugging raises DeviceLost; after plugging in again the same driver opens the box, which is dark."""
    rig.box.set_level("spot", DriveLevel(30000))
    rig.server.unplug()
    with pytest.raises(DeviceLost):
        rig.box.status()
    rig.box.close()
    assert rig.wait_until(lambda: rig.duty("spot") == 0)  # the dead man
    rig.server.plug()
    # What lies in the line before the host speaks, half lines among it, does not keep it from opening.
    rig.server.say(b"\x00\xff\x80boot loader\r\n=05 OK radio\n!01 BT D 5.000*00000000\n=07 O")
    rig.box.open()
    assert rig.box.set_level("spot", DriveLevel(100)).drive.level == 100


def test_killed_host_leaves_the_bleach_dark(rig, project_root):
    """A host killed with SIGKILL while the bleach is on: dark within 1.1 s of box time."""
    rig.box.close()
    script = (
        "import sys,time;from drivers.light_box.box import SerialLightBox;from drivers.light_box.link import BoxLink;"
        "from drivers.light_box.serial_line import SerialLine;from radiometer.devices import DriveLevel;"
        "from radiometer.devices.exposure_ledger import ExposureLedger;"
        "from radiometer.devices.retinal_safety import ChannelOptics;"
        "optics=dict.fromkeys(['bleach','spot','spot_red','fixation'],ChannelOptics(None,0.0,60.0,5.0));"
        "from radiometer.devices.exposure_account import MemoryStore;"
        "store=MemoryStore(time.monotonic,('TWIN0001','AVR00001'));"
        f"box=SerialLightBox(BoxLink(SerialLine({rig.server.port!r})),ExposureLedger(optics,store));"
        "box.open();box.set_level('bleach',DriveLevel(50000));print('on',flush=True);time.sleep(60)"
    )
    host = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, cwd=project_root)
    try:
        assert b"on\n" in iter(host.stdout.readline, b"")  # after what is logged
        assert rig.wait_until(lambda: rig.duty("bleach") > 0.7)
        time.sleep(1.2)
        assert rig.duty("bleach") > 0.7  # its driver keeps it on
        os.kill(host.pid, signal.SIGKILL)
        killed_s = rig.box_time_s()
        assert rig.wait_until(lambda: rig.duty("bleach") == 0)
        assert 0 < rig.went_dark_s() - killed_s < 1.1
    finally:
        host.kill()
        host.wait()
        if host.stdout is not None:
            host.stdout.close()


@pytest.mark.slow
def test_bad_line_sets_no_wrong_level(rig):
    """With 1 % of the bytes wrong both ways, every level read back as set is the one at the pin."""
    rig.server.faults_in.corrupt = rig.server.faults_out.corrupt = 0.01
    rng = np.random.default_rng(21)
    for _ in range(30):
        level = int(rng.integers(1000, 60000))
        assert _set_in_the_end(rig, level).drive.level == level
    assert rig.server.faults_in.touched + rig.server.faults_out.touched > 30
    rig.server.faults_in.corrupt = rig.server.faults_out.corrupt = 0.0
    expected = _set_in_the_end(rig, level).duty_steps / rig.box.channels["spot"].duty_steps
    assert rig.wait_until(lambda: abs(rig.duty("spot") - expected) < 0.004)


def _set_in_the_end(rig, level):
    """Set a level; a box that has gone dark meanwhile, as on a computer too busy to run it, is opened again."""
    for _ in range(5):
        try:
            return rig.box.set_level("spot", DriveLevel(level, CurrentRange.LOW))
        except DeviceError:
            rig.box.close()
            rig.box.open()
    raise AssertionError(f"level {level} could not be set")
