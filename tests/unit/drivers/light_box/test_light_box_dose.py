"""The driver's account of what the eye is given: every verb, every channel, every way in which light ends."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from radiometer.devices import CurrentRange, DriveLevel
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import DeviceError, SettingOutOfRange, UnsafeStimulus, UsageError
from simulators.light_box.box import LightBoxTwin, TwinSettings
from simulators.light_box.virtual_line import VirtualLine

# B = 1 over the whole line: L·t = 10⁶ J·sr⁻¹·m⁻² is the blue-light limit, and 10⁵ what is allowed of it.
BLUE = ChannelOptics(437.5, 0.5, 40.0, 1000.0, low_range_ratio_bound=0.01)
ALLOWED_J = 1e5
LONG_S = 9000.0  # so dim over so long that the thermal limit is far
HIGH, LOW = CurrentRange.HIGH, CurrentRange.LOW


class Table:
    """A calibration in which the field at full level is certainly below 500 W·sr⁻¹·m⁻²."""

    def drive_for(self, channel, radiance_w_sr_m2):
        return round(radiance_w_sr_m2 / 400.0 * 65535), True

    def highest_radiance(self, channel, level, high):
        return 500.0 * level / 65535 * (1.0 if high else 0.02) if channel == "field" else None


def bench(calibration=None):
    """Return a twin, its line and an opened driver whose channels are all blue."""
    twin = LightBoxTwin(TwinSettings())
    line = VirtualLine(twin, latency_s=0.0003)
    optics = dict.fromkeys(("bleach", "field", "spot", "spot_red"), BLUE)
    box = SerialLightBox(BoxLink(line), ExposureLedger(optics, line.now), calibration, keep_alive=False)
    box.open()
    return twin, line, box


def pass_time(line, box, seconds):
    end_s = line.now() + seconds
    while (left_s := end_s - line.now()) > 1e-9:
        line.wait(min(left_s, 0.2))
        box.tend_if_due()


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
    return low


def half(current=HIGH):
    """Return a level of half of full: 500 W·sr⁻¹·m⁻² at the high current, 5 at the low."""
    return DriveLevel(32767, current)


@pytest.mark.parametrize(("current", "radiance"), [(HIGH, 500.0), (LOW, 5.0)])
@pytest.mark.parametrize(
    ("light", "seconds", "bright_s"),
    [
        (lambda box, level: box.set_level("field", level), 3.0, 3.0),
        (lambda box, level: box.ramp("field", level, 1.0), 3.0, 3.0),
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


def test_pulse_after_pulse_is_refused_at_the_allowed_dose():
    """20 s at 1000 W·sr⁻¹·m⁻² are a fifth of what is allowed: the sixth is refused, with no light."""
    twin, line, box = bench()
    level = DriveLevel(60000, HIGH)
    for _ in range(5):
        box.pulse("field", level, 20.0)
        pass_time(line, box, 21.0)
    with pytest.raises(UnsafeStimulus, match="blue-light"):
        box.pulse("field", level, 20.0)
    assert twin.duty("field") == 0.0
    with pytest.raises(UnsafeStimulus):
        box.foresee("spot", level, 20.0)
    pass_time(line, box, 0.2)
    assert box.pulse("field", level, 8.0).drive == level


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
    assert box.highest_level("field") == pytest.approx(65535 * 10.0 / 1000.0 * (1.0 - 0.4578), rel=0.01)
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
        lambda: box.pulse("field", level, 600.1),
        lambda: box.blink("field", level, 60.1, 1.0, 1),
        lambda: box.blink("field", level, 1.0, 1.0, -1),
        lambda: box.blink("field", level, 1.0, 1.0, 65536),
    ):
        with pytest.raises(SettingOutOfRange):
            call()
    assert box.pulse("field", level, 600.0).drive == level
    box.off("field")
    assert box.blink("field", level, 60.0, 60.0, 2).drive == level


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


doses = st.lists(
    st.tuples(st.sampled_from("ab"), st.floats(0.1, 50.0), st.floats(0.5, 300.0), st.floats(0.0, 4000.0)),
    min_size=1,
    max_size=8,
)


@settings(max_examples=60, deadline=None)
@given(doses)
def test_the_account_is_the_sum_over_the_last_ten_thousand_seconds(given_doses):
    """Whatever was shone, in whichever channel: the fraction left is one tenth less Σ L·t of the window / 10⁶."""
    clock = Clock()
    account = ExposureLedger({"a": BLUE, "b": BLUE, "c": BLUE}, clock)
    ended = []
    for channel, radiance, seconds, pause in given_doses:
        account.shine(channel, radiance, seconds)
        clock.now_s += seconds
        account.darken(channel)
        ended.append((clock.now_s, radiance * seconds))
        clock.now_s += pause + 11.0  # what ends within 10 s is kept as one entry
    inside = sum(dose for when, dose in ended if clock.now_s - when < 1e4)
    spare = (0.1 - inside / 1e6) * 1e6
    if spare > 100.0:
        account.refuse_unsafe("c", spare * 0.99 / LONG_S, LONG_S)
    with pytest.raises(UnsafeStimulus):
        account.refuse_unsafe("c", (max(spare, 0.0) * 1.01 + 1.0) / LONG_S, LONG_S)


def test_what_still_shines_counts_to_its_planned_end():
    """A pulse of 50 s under way counts whole; what its own channel has given counts beside what follows."""
    clock = Clock()
    account = ExposureLedger({"a": BLUE, "b": BLUE}, clock)
    account.shine("a", 1000.0, 50.0)
    clock.now_s = 10.0
    account.refuse_unsafe("b", 1000.0, 49.9)
    with pytest.raises(UnsafeStimulus):
        account.refuse_unsafe("b", 1000.0, 50.5)
    account.refuse_unsafe("a", 1000.0, 89.0)
    with pytest.raises(UnsafeStimulus):
        account.refuse_unsafe("a", 1000.0, 91.0)
    clock.now_s = 200.0  # long over: 50 s were given
    account.refuse_unsafe("a", 1000.0, 49.0)
    with pytest.raises(UnsafeStimulus):
        account.refuse_unsafe("a", 1000.0, 51.0)


def test_thermal_limits_of_lights_together_add_up():
    """Two channels at 6 % of the thermal limit each are more than the tenth."""
    account = ExposureLedger({"a": BLUE, "b": BLUE}, Clock())
    six_percent = 0.06 * 50_000 / (10.0 * 0.1)  # R = 10, α capped at 100 mrad, 1 s
    account.refuse_unsafe("a", six_percent, 1.0)
    account.shine("a", six_percent, 1.0)
    with pytest.raises(UnsafeStimulus, match="thermal"):
        account.refuse_unsafe("b", six_percent, 1.0)


@pytest.mark.parametrize(("seconds", "milliseconds"), [(1.001, 1001), (0.0025, 2), (0.0035, 4), (16.32, 16320)])
def test_durations_are_rounded_to_whole_milliseconds(seconds, milliseconds):
    """What binary numbers hold a little below is not cut by a millisecond."""
    _, _, box = bench()
    assert box._milliseconds("duration", seconds, 600.0) == milliseconds
    with pytest.raises(SettingOutOfRange):
        box._milliseconds("duration", 600.001, 600.0)


def test_a_box_that_shines_otherwise_than_asked_is_darkened(monkeypatch):
    """Another level read back is no level: every channel goes dark and it is said."""
    twin, _, box = bench()
    exact = box.read_channel
    monkeypatch.setattr(
        SerialLightBox, "read_channel", lambda self, channel: replace(exact(channel), drive=DriveLevel(99, LOW))
    )
    with pytest.raises(DeviceError, match="every channel was darkened"):
        box.set_level("field", DriveLevel(100, LOW))
    assert twin.duty("field") == 0.0


def test_the_keeper_looks_often_enough_for_the_box_to_stay_lit(monkeypatch):
    """What it waits between two looks and a quarter of the dead-man time together stay far below that second."""
    _, line, box = bench()
    waited, tended = [], []

    def wait(seconds):
        waited.append(seconds)
        line.wait(seconds)
        return len(waited) > 40

    synchronise = SerialLightBox.synchronise
    monkeypatch.setattr(SerialLightBox, "synchronise", lambda self: tended.append(line.now()) or synchronise(self))
    box._closing = SimpleNamespace(wait=wait)
    begun_s = line.now()
    box._keep()
    apart = [later - earlier for earlier, later in itertools.pairwise([begun_s, *tended])]
    assert len(tended) >= 5
    assert max(apart) < 0.4
    assert min(apart[1:]) >= 0.25


def test_a_keeper_whose_box_is_gone_ends(monkeypatch):
    """It leaves the reason to whoever asks next, and asks no more."""
    _, _, box = bench()
    asked = []

    def gone(self):
        asked.append(1)
        raise DeviceError("gone")

    monkeypatch.setattr(SerialLightBox, "tend_if_due", gone)
    box._closing = SimpleNamespace(wait=lambda _: False)
    box._keep()
    assert asked == [1]


def test_a_box_that_is_opened_again_is_kept_alive_again(monkeypatch):
    """Each opening has a keeper that goes on until the box is closed; without keep-alive there is none."""
    told_to_end = []
    monkeypatch.setattr(SerialLightBox, "_keep", lambda self: told_to_end.append(self._closing.is_set()))
    _, _, box = bench()
    assert (box._keeper, told_to_end) == (None, [])
    box.close()
    box.keep_alive = True
    for _ in range(2):
        box.open()
        assert box._keeper is not None
        box.close()
        assert (box._keeper, box._closing.is_set()) == (None, True)
    assert told_to_end == [False, False]
