"""The driver's account of what the eye is given: every verb, every channel, every way in which light ends."""

import math
import threading

import pytest

from radiometer.devices import CurrentRange, DriveLevel
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import SettingOutOfRange, UnsafeStimulus, UsageError
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.lines import VirtualLine
from testing.box_on_a_line import driver_on, pass_time

# B = 1 over the whole line: L·t = 10⁶ J·sr⁻¹·m⁻² is the blue-light limit, and 10⁵ what is allowed of it.
BLUE = ChannelOptics(437.5, 0.5, 40.0, 1000.0, low_range_ratio_bound=0.01)
ALLOWED_J = 1e5
LONG_S = 9000.0  # so dim over so long that the thermal limit is far
SLOW = 1.01  # the box's clock may be so much slower: planned times count as so much longer
HIGH, LOW = CurrentRange.HIGH, CurrentRange.LOW


class Table:
    """A calibration in which the field at full level is certainly below 500 W·sr⁻¹·m⁻²."""

    def drive_for(self, channel, radiance_w_sr_m2):
        return round(radiance_w_sr_m2 / 400.0 * 65535), True

    def highest_radiance(self, channel, level, high):
        return 500.0 * level / 65535 * (1.0 if high else 0.02) if channel == "field" else None


def bench(calibration=None):
    """Return a twin, its line and an opened driver whose channels are all blue."""
    twin = SimulatedLightBox(SimulatedBoxSettings())
    line = VirtualLine(twin, latency_s=0.0003)
    optics = dict.fromkeys(("bleach", "field", "spot", "spot_red"), BLUE)
    box = driver_on(line, optics, calibration)
    box.open()
    return twin, line, box


def left_j(box, channel="spot"):
    """Return how many J·sr⁻¹·m⁻² more the account would let through on a channel."""
    low, high = 0.0, 2.0 * ALLOWED_J
    for _ in range(40):
        middle = (low + high) / 2.0
        try:
            box.ledger.refuse_unsafe(channel, middle / LONG_S, LONG_S)
            low = middle
        except UnsafeStimulus:
            high = middle
    return low * SLOW


def half(current=HIGH):
    """Return a level of half of full: 500 W·sr⁻¹·m⁻² at the high current, 5 at the low."""
    return DriveLevel(32767, current)


@pytest.mark.parametrize(("current", "radiance"), [(HIGH, 500.0), (LOW, 5.0)])
@pytest.mark.parametrize(
    ("light", "seconds", "bright_s"),
    [
        (lambda box, level: box.set_level("field", level), 3.0, 3.0),
        (lambda box, level: box.ramp("field", level, 1.0), 3.0, 4.0),  # the ramp counts as its end, and then that
        (lambda box, level: box.pulse("field", level, 2.0), 3.0, 2.0),
        (lambda box, level: box.blink("field", level, 0.5, 0.5, 4), 6.0, 2.0),
    ],
    ids=["steady", "ramp", "pulse", "blink"],
)
def test_light_that_was_given_is_in_the_account(light, seconds, bright_s, current, radiance):
    """Bound times bright time, for each verb and both currents, once the light has ended."""
    _, line, box = bench()
    full = left_j(box)
    try:
        light(box, half(current))
    except UnsafeStimulus:  # without an end: only where 10⁴ s of it are allowed
        assert (current, seconds) == (HIGH, 3.0)
        return
    pass_time(line, box, seconds)
    box.off("field")
    assert full == pytest.approx(ALLOWED_J, rel=1e-3)
    assert full - left_j(box) == pytest.approx(radiance * bright_s, rel=0.02)


def test_a_calibration_s_upper_bound_counts_instead_of_the_preset_s():
    """500 instead of 1000 W·sr⁻¹·m⁻² at full level; where it knows nothing, the preset's."""
    _, line, box = bench(Table())
    box.pulse("field", half(), 2.0)
    pass_time(line, box, 3.0)
    box.off("field")
    assert ALLOWED_J - left_j(box) == pytest.approx(500.0, rel=0.02)
    box.pulse("bleach", half(), 2.0)
    pass_time(line, box, 3.0)
    box.off("bleach")
    assert ALLOWED_J - left_j(box) == pytest.approx(1500.0, rel=0.02)


@pytest.mark.parametrize("end", ["off", "safe", "button", "close", "other level"])
def test_every_end_of_the_light_keeps_what_it_gave(end):
    """Two of ten seconds of 5 W·sr⁻¹·m⁻² stay in the account, no more and no less."""
    twin, line, box = bench()
    box.set_level("field", half(LOW))
    if end == "button":
        twin.press(line.now())
        pass_time(line, box, 4.0)
        given_s = 3.0
    else:
        pass_time(line, box, 2.0)
        given_s = 2.0
    if end == "off":
        box.off("field")
    elif end == "safe":
        box.safe()
    elif end == "close":
        box.close()
    elif end == "other level":
        box.set_level("field", DriveLevel(0, LOW))
    assert ALLOWED_J - left_j(box) == pytest.approx(5.0 * given_s, rel=0.2)


def test_what_is_foreseen_is_what_is_counted():
    """Fractions of both limits by hand; the box's energy budget is held in s at the level."""
    _, _, box = bench()
    found = box.foresee("field", half(), 2.0)
    assert found.blue_light == pytest.approx(500.0 * 2.0 / 1e6, rel=1e-3)
    assert found.thermal == pytest.approx(10.0 * 500.0 * 0.1 * 2.0**0.25 / 50_000, rel=1e-2)
    # 70.5·10⁶ units at 128 per ms are 550 s at half of the high current, at one per ms 70 500 s at the low one.
    box.ledger.allowed_fraction = 1e9
    assert box.foresee("field", half(), 550.0).blue_light > 0.1
    with pytest.raises(UnsafeStimulus, match="551 s"):
        box.foresee("field", half(), 552.0)
    assert box.foresee("field", half(LOW), 70_000.0).blue_light > 0.01
    with pytest.raises(UnsafeStimulus):
        box.foresee("field", half(LOW), 71_000.0)


def test_the_highest_level_is_the_account_s():
    """Steady light may give 10 W·sr⁻¹·m⁻² at most: level 655 of 65535; less after light was given, 0 without optics."""
    _, line, box = bench()
    assert box.highest_level("field") == pytest.approx(65535 * 10.0 / 1000.0, abs=1.0)
    box.pulse("field", DriveLevel(60000, HIGH), 50.0)
    pass_time(line, box, 51.0)
    box.off("field")
    assert box.highest_level("field") == pytest.approx(65535 * 10.0 / 1000.0 * (1.0 - 0.4578 * SLOW), rel=0.01)
    assert box.highest_level("fixation") == 0
    with pytest.raises(UsageError, match="fixation"):
        box.set_level("fixation", DriveLevel(1))


@pytest.mark.parametrize("low", [0.0, -1.0, 0.0009, math.nan, math.inf])
def test_times_beyond_the_protocol_are_refused(low):
    """1 ms to 600 s for pulses and ramps, to 60 s for blinks; 0 to 65535 blinks."""
    _, _, box = bench()
    level = DriveLevel(1, LOW)
    for call in (
        lambda: box.pulse("field", level, low),
        lambda: box.ramp("field", level, low),
        lambda: box.blink("field", level, low, 1.0, 1),
        lambda: box.blink("field", level, 1.0, low, 1),
        lambda: box.pulse("field", level, 600.001),
        lambda: box.blink("field", level, 60.1, 1.0, 1),
        lambda: box.blink("field", level, 1.0, 1.0, -1),
        lambda: box.blink("field", level, 1.0, 1.0, 65536),
    ):
        with pytest.raises(SettingOutOfRange):
            call()
    assert box.pulse("field", level, 600.0).drive == level
    box.off("field")
    assert box.blink("field", level, 60.0, 60.0, 2).drive == level


def keepers():
    """Return how many threads keep a light box alive just now."""
    return sum(thread.name == "light box" for thread in threading.enumerate())


def test_a_box_that_is_opened_again_is_kept_alive_again():
    """Each opening has a keeper that goes on until the box is closed; without keep-alive there is none."""
    _, _, box = bench()
    before = keepers()
    box.close()
    box.keep_alive = True
    for _ in range(2):
        box.open()
        assert keepers() == before + 1
        box.close()
        assert keepers() == before
