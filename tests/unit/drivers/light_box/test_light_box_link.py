"""The link to a light box: answers, events, clock, and the second version of its protocol."""

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.light_box.box import read_capabilities, read_flash, read_identity, read_state, read_status
from drivers.light_box.link import BoxClock, BoxLink, BoxRefusal, ClockSample, Event, EventInbox, parse_times
from drivers.light_box.serial_line import ReceivedLine
from radiometer.devices.light_box import (
    ChannelCapabilities,
    ChannelMode,
    ChannelState,
    CurrentRange,
    DriveLevel,
    FlashState,
    LightBoxIdentity,
    LightBoxStatus,
)
from radiometer.devices.retinal_safety import ChannelOptics, FlashLight
from radiometer.errors import (
    DeviceError,
    DeviceLost,
    DeviceTimeout,
    MeasurementError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.lines import VirtualLine
from testing.box_on_a_line import driver_on, pass_time, sealed


class ScriptedLine:
    """A line that answers each request by what a script says; its clock runs by waiting."""

    name = "scripted"

    def __init__(self, script):
        self.script, self.time_s, self.sent, self.waiting = deque(script), 0.0, [], deque()

    def now(self):
        return self.time_s

    def write(self, data):
        self.sent.append(data.decode())
        number = data[1:3].decode()
        answers = self.script.popleft() if self.script else ()
        self.waiting += [sealed(text.replace("SS", number).encode()) for text in answers]
        return self.time_s

    def read_line(self, timeout_s):
        if self.waiting:
            self.time_s += 0.001
            return ReceivedLine(self.waiting.popleft(), self.time_s)
        self.time_s += timeout_s
        return None


def link_of(*script):
    line = ScriptedLine(script)
    return line, BoxLink(line)


def test_an_answer_is_that_of_its_own_request():
    """A late answer to another is passed over; lost twice, a request is sent three times under one number."""
    line, link = link_of(("=00 OK late",), ("=SS OK mine",))
    with pytest.raises(DeviceTimeout):
        link.request("ST", attempts=1)
    line.waiting.append(sealed(b"=01 OK late"))
    assert link.request("ST") == ("mine",)
    line, link = link_of((), (), ("=SS OK done",))
    assert link.request("PU 1 L 5 10") == ("done",)
    assert len(line.sent) == 3
    assert len(set(line.sent)) == 1
    assert link.retries == 2


@pytest.mark.parametrize(("code", "kind"), [(5, BoxRefusal), (6, UnsafeStimulus), (7, DeviceLost)])
def test_what_a_refusal_means(code, kind):
    """The energy budget is the eye's safety; a dark session is lost, and stays so until it is opened again."""
    _, link = link_of((f"=SS ER {code:02d}",), ("=SS OK",))
    with pytest.raises(kind):
        link.request("SL 1 H 60000")
    if kind is DeviceLost:
        with pytest.raises(DeviceLost):
            link.request("ST")
    else:
        link.request("ST")


def test_a_box_that_went_dark_by_itself_is_lost():
    """The event of its dead-man timer ends the session; the one of the button is reported and ends nothing."""
    for argument, ends in (("D", True), ("B", False)):
        line, link = link_of(("=SS OK",))
        link.inbox.start_after(4)
        line.waiting.append(sealed(f"!05 DK {argument} 12.345".encode()))
        link.listen(0.1)
        assert link.take_turned_off() is not ends
        if ends:
            with pytest.raises(DeviceLost, match="gone dark because this program was silent"):
                link.request("ST")
        else:
            link.request("ST")


@pytest.mark.parametrize(("text", "number"), [("0F", 15), ("10", 16), ("FF", 255)])
def test_the_latest_event_s_number_is_hexadecimal(text, number):
    """Times in ms become s; a number of two hexadecimal digits."""
    assert parse_times(("1500.000", "1500.250", text)) == pytest.approx((1.5, 1.50025, number))
    assert parse_times(("1500.000", "1500.250", "F")) is None


def test_a_press_long_after_the_last_comparison_follows_the_drift():
    """A clock that gains a thousandth, compared for 100 s: 50 s later the offset has gone on by 50 ms."""
    clock = BoxClock()
    for step in range(401):
        host_s = 0.25 * step
        box_s = host_s * 1.001
        clock.add(ClockSample(host_s, box_s, box_s, host_s))
    time_s, u_s = clock.host_time_s(150.0 * 1.001)
    assert time_s == pytest.approx(150.0, abs=4 * u_s)
    assert u_s < 0.005
    assert clock.estimate().drift_ppm == pytest.approx(1000.0, rel=0.01)


def test_a_box_that_boots_again_has_ended_the_session():
    """Its numbers start again: before the first comparison that is how it greets, after it the light is gone."""
    for known, ends in ((False, False), (True, True)):
        line, link = link_of(("=SS OK",))
        if known:
            link.inbox.start_after(4)
        line.waiting.append(sealed(b"!00 BO P 0.004"))
        link.listen(0.1)
        if ends:
            with pytest.raises(DeviceLost, match="has restarted; every channel is dark, reopen it"):
                link.request("ST")
        else:
            assert link.request("ST") == ()


def test_an_event_that_the_box_no_longer_has_holds_back_none_after_it():
    """Of events 5 and 6 the box has forgotten the first: the second is handed out, one is counted as lost."""
    line, link = link_of(("=SS OK 1.000 1.100 06",), ("=SS ER 11",), ("=SS OK BT D 12.345",))
    link.inbox.start_after(4)
    link.compare_clocks()
    assert [(event.number, event.kind, event.argument) for event in link.take_events()] == [(6, "BT", "D")]
    assert link.inbox.lost == 1
    assert [words.split("*")[0][4:] for words in line.sent] == ["TM", "EV 05", "EV 06"]


STATUS = ("12015", "-253", "3", "4", "5", "B", "1", "0")


def test_answers_in_physical_units():
    """mV, tenths of a degree, ms and units of the bucket become V, °C, s and a share."""
    assert read_identity("p", ("radiometer-light-box", "2", "1.4", "LB-7", "6")) == (
        LightBoxIdentity("LB-7", "1.4", 2, "p"), 6
    )  # fmt: skip
    limits = {CurrentRange.LOW: 65535, CurrentRange.HIGH: 30000}
    fields = ("spot", "505", "8000", "2000", "65535", "30000", "900", "0")
    assert read_capabilities("p", fields) == (ChannelCapabilities("spot", 505.0, 8000, 2000.0, limits), 900)
    white = read_capabilities("p", ("bleach", "0", *fields[2:]))[0]
    assert white.peak_nm is None
    assert read_state("p", "spot", 900, ("R", "H", "1234", "151", "300")) == ChannelState(
        "spot", ChannelMode.RAMP, DriveLevel(1234, CurrentRange.HIGH), 151, pytest.approx(1 / 3)
    )
    assert read_status("p", STATUS) == LightBoxStatus(12.015, -25.3, 3, 4, 5, "brown-out", True)
    assert read_flash("p", ("4", "1250")) == FlashState(4, 1.25)


@pytest.mark.parametrize(
    "read",
    [
        lambda: read_status("p", STATUS[:-1]),
        lambda: read_status("p", ("x", *STATUS[1:])),
        lambda: read_status("p", (*STATUS[:5], "Q", *STATUS[6:])),
        lambda: read_state("p", "spot", 900, ("X", "H", "1", "1", "1")),
        lambda: read_state("p", "spot", 900, ("S", "M", "1", "1", "1")),
        lambda: read_state("p", "spot", 900, ("S", "L", "-1", "1", "1")),
        lambda: read_state("p", "spot", 900, ("S", "L", "1", "1")),
        lambda: read_flash("p", ("4",)),
        lambda: read_flash("p", ("4", "soon")),
        lambda: read_capabilities("p", ("spot", "505", "8000", "2000", "65535", "30000", "900")),
        lambda: read_identity("p", ("radiometer-light-box", "2", "1.4", "LB-7", "six")),
        lambda: read_identity("p", ("radiometer-light-box", "99", "1.4", "LB-7", "6")),
        lambda: read_identity("p", ("kettle", "2", "1.4", "LB-7", "6")),
    ],
)
def test_an_answer_without_sense_is_refused(read):
    """Too few fields, no number, an unknown letter, another device."""
    with pytest.raises(DeviceError, match="on p"):
        read()


def event(number):
    """Return an event of that number."""
    return Event(number, "BT", "D", float(number))


@given(st.integers(0, 255), st.permutations(range(1, 6)))
def test_events_are_released_once_and_in_their_order(start, order):
    """In whatever order they come, and each twice: one waits for those before it; after 255 comes 0."""
    inbox, released = EventInbox(), list[int]()
    inbox.start_after(start)
    expected = [(start + step) % 256 for step in range(1, 6)]
    for count, step in enumerate([*order, *order], start=1):
        inbox.put(event(expected[step - 1]))
        assert inbox.missing(expected[-1]) == [expected[one - 1] for one in sorted(order[count:])]
        released += [one.number for one in inbox.release()]
        assert released == expected[: min(order[count:], default=6) - 1]


def test_event_that_the_box_dropped_does_not_block():
    """Of 20 missing events the oldest four are given up, and counted."""
    inbox = EventInbox()
    inbox.start_after(0)
    assert inbox.missing(20) == list(range(5, 21))
    assert inbox.lost == 4
    for number in range(5, 21):
        inbox.put(event(number))
    assert [e.number for e in inbox.release()] == list(range(5, 21))


def exchange(host_s, offset_s, out_s, back_s, rate=0.0):
    """Return an exchange at a host time with given delays; the box's clock runs `rate` fast."""
    box_s = (host_s + out_s - offset_s) * (1 + rate)
    return ClockSample(host_s, box_s, box_s + 0.001 * (1 + rate), host_s + out_s + 0.001 + back_s)


@pytest.mark.parametrize(
    ("sample", "within_s"),
    [
        (exchange(10.0, 3.0, 0.004, 0.004), 1e-12),
        (ClockSample(10.0, 7.0 + 0.0014, 7.0 + 0.0014, 10.0 + 0.0014 + 0.0036, 0.0014, 0.0036), 1e-12),
        (ClockSample(10.0, 7.00005, 7.00005, 10.0001, 0.0014, 0.0036), 1e-9),
    ],
    ids=["equal delays", "wire time of a short request and a long answer", "faster than its bytes on a wire"],
)
def test_delays_that_are_known_leave_the_exact_offset(sample, within_s):
    """Equal both ways, or as long as the bytes take on the wire; a port without wire time is taken as it is."""
    assert sample.offset_s == pytest.approx(3.0, abs=within_s)
    assert sample.free_delay_s >= -1e-12


def test_one_sided_delay_stays_within_the_stated_bound():
    """It errs by half of the delay at most; a hundred exchanges average the slack out, not the asymmetry."""
    clock = BoxClock()
    for step in range(100):
        clock.add(exchange(0.25 * step, 3.0, 0.002, 0.0))
    time_s, u_s = clock.host_time_s(20.0)
    assert abs(time_s - 23.0) <= 0.001 + 1e-6
    assert u_s >= 0.001 / np.sqrt(3)
    clock = BoxClock()
    for _ in range(100):
        clock.add(exchange(10.0, 3.0, 0.001, 0.001))
    asymmetry, slack = 0.002 / 2 / np.sqrt(3), 0.0025 / 2 / np.sqrt(3)
    assert clock.host_time_s(7.001)[1] == pytest.approx(np.hypot(asymmetry, slack / 10.0), rel=1e-4)


@pytest.mark.parametrize("rate", [2e-4, -2e-4, 4e-3])
def test_drift_is_found_within_its_uncertainty(rate):
    """Drift comes out within three stated standard uncertainties."""
    rng = np.random.default_rng(5)
    clock = BoxClock()
    for step in range(400):
        clock.add(exchange(0.25 * step, 0.0, *rng.exponential(2e-4, 2), rate=rate))
    found = clock.estimate()
    assert abs(found.drift_ppm - 1e6 * rate / (1 + rate)) < 3 * found.u_drift_ppm
    assert found.u_drift_ppm < 5.0


def test_one_exchange_is_known_by_its_delay_and_the_rate_by_what_resonators_hold():
    """2 ms there and back: ±1 ms of asymmetry and ±1.25 ms of slack as rectangles; 0.5 % for every second away."""
    clock = BoxClock()
    with pytest.raises(MeasurementError, match="synchronise"):
        clock.host_time_s(1.0)
    clock.add(exchange(10.0, 3.0, 0.001, 0.001))
    sample_s = 10.0 + 0.001 - 3.0
    asymmetry, slack = 0.002 / 2 / np.sqrt(3), 0.0025 / 2 / np.sqrt(3)
    for away_s in (0.0, 2.0, -2.0):
        time_s, u_s = clock.host_time_s(sample_s + away_s)
        assert time_s == pytest.approx(sample_s + away_s + 3.0, abs=1e-9)
        assert u_s == pytest.approx(np.sqrt(asymmetry**2 + slack**2 + (0.005 * away_s) ** 2), rel=1e-4)
    assert clock.estimate().u_drift_ppm == pytest.approx(5000.0)


def test_the_last_512_exchanges_are_kept():
    """Two minutes of tending a quarter of a second apart: an old clock's rate does not hold a new one back."""
    clock = BoxClock()
    for step in range(600):
        clock.add(exchange(0.25 * step, 3.0, 0.0001, 0.0001))
    assert clock.estimate().samples == 512
    assert clock.samples[0].sent_s == 0.25 * 88


def test_half_a_millisecond_more_than_the_least_delay_is_slack_and_more_is_a_hold_up():
    """An exchange within it moves the line by its own offset; one beyond it, or 20 ms late, does not."""
    for late_s, moves in ((0.00049, True), (0.00051, False)):
        clock = BoxClock()
        clock.add(exchange(10.0, 3.0, 0.0, 0.0))
        clock.add(exchange(10.0, 3.0, late_s, 0.0))
        assert clock.host_time_s(7.0)[0] == pytest.approx(10.0 - late_s / 4 if moves else 10.0, abs=1e-5)
    clock = BoxClock()
    for step in range(100):
        clock.add(exchange(0.25 * step, 3.0, 0.02 if step % 3 else 0.0001, 0.0001))
    assert clock.host_time_s(12.0)[0] == pytest.approx(15.0, abs=3e-4)


FIELD = ChannelOptics(None, 0.0, 40.0, 40.0)

WHITE_BLUE, WHITE_RED = 0.40629, 4.5181  # of the stated white: worked out in test_exposure_limits_twice.py

FLASH = FlashLight(exposure_j_sr_m2=100.0, exposure_bound_j_sr_m2=120.0, duration_s=0.003, subtense_deg=40.0)


def bench(version=2, flash=FLASH):
    """Return a twin, its line and an opened driver."""
    twin = SimulatedLightBox(SimulatedBoxSettings(newest_version=version))
    line = VirtualLine(twin, latency_s=0.0003)
    optics = dict.fromkeys(("bleach", "field"), FIELD) | {"spot": ChannelOptics(453.0, 22.0, 1.5, 4.0)}
    if flash is not None:
        optics["flash"] = flash.optics
    box = driver_on(line, optics, flash=flash)
    box.open()
    return twin, line, box


def test_new_box_has_six_channels_and_an_old_one_its_four():
    """The driver asks for version 2 first and takes version 1 where that is refused."""
    _, _, new = bench()
    assert (new.identity.protocol_version, list(new.channels)[4:]) == (2, ["spot_green", "field"])
    _, _, old = bench(version=1)
    assert (old.identity.protocol_version, len(old.channels)) == (1, 4)
    old.pulse("spot", DriveLevel(500, CurrentRange.LOW), 0.1)
    with pytest.raises(UsageError, match="version 1, which has no flash"):
        old.fire_flash()
    with pytest.raises(UsageError, match="no channel 'field'"):
        old.set_level("field", DriveLevel(1))


def test_over_bright_requests_are_refused_before_a_byte_is_sent():
    """Above the level limit, beyond a tenth of the blue-light limit, beyond the energy budget: no light each time."""
    twin, _, box = bench()
    with pytest.raises(SettingOutOfRange):
        box.pulse("field", DriveLevel(60001), 1.0)
    with pytest.raises(UnsafeStimulus, match="blue-light"):
        box.set_level("field", DriveLevel(60000))  # 36.6 W/sr/m², 0.406 of it blue, for 10⁴ s: 15 %
    with pytest.raises(UnsafeStimulus, match="energy budget"):
        box.foresee("field", DriveLevel(60000), 301.0)
    assert all(channel.bucket == channel.limits.bucket for channel in twin.channels)
    box.pulse("field", DriveLevel(60000), 299.0)


def test_flash_is_judged_as_a_pulse_and_counted():
    """One flash of 120 J/sr/m² in 3 ms is 8.5 % of the thermal limit and adds 4.9·10⁻⁵ of the blue-light limit."""
    twin, line, box = bench()
    one = box.foresee_flashes(1)
    assert one.thermal == pytest.approx(WHITE_RED * 120 / 0.003 * 0.1 * 0.003**0.25 / 50_000, rel=1e-3)
    assert 0.08 < one.thermal < 0.1
    assert box.foresee_flashes(8).blue_light == pytest.approx(8 * WHITE_BLUE * 120 / 1e6, rel=1e-3)
    assert box.fire_flash().left == 7
    with pytest.raises(UnsafeStimulus):
        box.fire_flash()  # the box wants 5 s between two
    pass_time(line, box, 5.1)
    box.fire_flash()
    assert len(twin.flash.fired_ms) == 2
    pass_time(line, box, 1.0)
    spent = 2 * WHITE_BLUE * 120 / 1e6
    limit_s = (0.1 / 1.01 - spent) * 1e6 / (WHITE_BLUE * 36.0)  # the box's clock may be 1 % slow
    box.ledger.refuse_unsafe("field", 36.0, limit_s * 0.9995)
    with pytest.raises(UnsafeStimulus):
        box.ledger.refuse_unsafe("field", 36.0, limit_s * 1.0005)


def test_too_strong_a_flash_is_refused_by_the_driver():
    """840 J/sr/m² in 1 ms, what bleaches 76 % of the rods at once, is beyond a tenth of the thermal limit."""
    twin, _, box = bench(flash=FlashLight(840.0, 840.0, 0.001, 40.0))
    with pytest.raises(UnsafeStimulus, match="thermal"):
        box.fire_flash()
    assert not twin.flash.fired_ms


def test_button_that_turns_the_lights_off_ends_them_in_the_account():
    """Held for 3 s it ends the field's light; from then on nothing more is counted, and the session goes on."""
    twin, line, box = bench()
    left = box.highest_level("field")
    box.pulse("field", DriveLevel(30000), 100.0)
    twin.press(line.now() + 1.0)
    twin.press(line.now() + 4.5, pressed=False)
    pass_time(line, box, 6.0)
    assert twin.duty("field") == 0
    assert 0 < left - box.highest_level("field") < 30000 * 5 / 1e4 + 64  # 4 s of light, a look, and a duty step
    assert math.isfinite(box.status().supply_v)
