"""The driver on a bad line in simulated time; parser, driver and box on arbitrary bytes: no crash, no hang."""

from collections import deque
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import Event, Reply, parse_event_fields, parse_line, parse_times, request_line
from drivers.light_box.serial_line import ReceivedLine
from radiometer.devices import DriveLevel
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import DeviceError, DeviceLost
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.lines import LineFaults, VirtualLine
from testing.box_on_a_line import driver_on, sealed

CHANNELS = ("bleach", "spot", "spot_red", "fixation")
OPTICS = {name: ChannelOptics(640.0, 18.0, 1.5, 1.0) for name in CHANNELS}


def bench(seed: int, **faults: float) -> tuple[SimulatedLightBox, VirtualLine, SerialLightBox]:
    """Return a twin, its line and an unopened driver."""
    rng = np.random.default_rng(seed)
    twin = SimulatedLightBox(SimulatedBoxSettings())
    line = VirtualLine(twin, LineFaults(**faults, rng=rng), latency_s=0.0003, rng=rng)
    return twin, line, driver_on(line, OPTICS)


@pytest.mark.parametrize("faults", [{"drop": 0.01}, {"insert": 0.01}, {"corrupt": 0.015}])
def test_other_damage_is_survived_too(faults):
    """Lost, invented and more wrong bytes cost time, never a wrong level."""
    twin, _, box = bench(13, **faults)
    box.open()
    for level in range(1, 200):
        assert box.set_level("spot", DriveLevel(level)).drive.level == level
        assert twin.channels[1].driven_level == level


def test_restart_is_noticed_where_its_announcement_is_lost():
    """By the clock running backwards, where no boot line arrives; the account holds only what was given before."""
    twin, line, box = bench(15)
    box.open()
    line.wait(0.5)
    twin.reset("W")
    twin.emitted.clear()
    with pytest.raises(DeviceLost, match="restarted"):
        box.tend()
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
    box = driver_on(line, OPTICS)
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


# Parser, driver and box on arbitrary bytes: no crash, no hang.


FRAGMENTS = st.sampled_from([b"=", b"!", b"*", b"#", b" OK", b" ER 05", b"--", b"TM", b"1.000", b"\n", b"00", b"HI 1"])
NOISE = st.lists(st.one_of(st.binary(max_size=20), FRAGMENTS), max_size=12).map(b"".join)


class BabblingLine:
    """A line on which anything may come; time passes only while it is read."""

    name = "babble"

    def __init__(self, lines: list[bytes]) -> None:
        self.lines = deque(lines)
        self.time_s = 0.0
        self.reads = 0

    def now(self) -> float:
        return self.time_s

    def open(self) -> None: ...

    def close(self) -> None: ...

    def write(self, line: bytes) -> float:
        return self.time_s

    def read_line(self, timeout_s: float) -> ReceivedLine | None:
        self.reads += 1
        assert self.reads < 5000, "the driver does not come to an end"
        if self.lines:
            self.time_s += 0.001
            return ReceivedLine(self.lines.popleft(), self.time_s)
        self.time_s += timeout_s
        return None


@given(st.one_of(NOISE, NOISE.map(sealed)))
def test_parser_takes_any_bytes(line):
    """Any line is a reply, an event or nothing."""
    found = parse_line(line)
    assert found is None or isinstance(found, Reply | Event)


@settings(max_examples=20)
@given(st.lists(st.text(max_size=12), max_size=6).map(tuple), st.integers(0, 255))
def test_fields_take_any_text(fields, number):
    """Fields that are not times or events are None; what is one has three times, or the number asked for."""
    times = parse_times(fields)
    assert times is None or (min(times) >= 0 and times[2] < 256)
    event = parse_event_fields(number, tuple(field.encode("ascii", "replace").decode() for field in fields))
    assert event is None or event.number == number


@given(st.integers(0, 255), st.integers(0, 3), st.integers(0, 65535))
def test_what_one_wrong_byte_makes_of_a_reply_is_never_another_reply(sequence, channel, level):
    """Changing any byte of an answer leaves nothing, or the answer itself."""
    line = sealed(f"={sequence:02X} OK H {level} {channel}".encode())
    original = parse_line(line)
    assert isinstance(original, Reply)
    for position in range(len(line)):
        changed = bytearray(line)
        changed[position] ^= 0x11
        assert parse_line(bytes(changed)) is None


@settings(deadline=None)
@given(st.lists(st.one_of(NOISE, NOISE.map(sealed)), max_size=40))
def test_opening_on_a_babbling_line_ends_in_a_named_error(lines):
    """Whatever comes, opening ends with a DeviceError within its deadline."""
    line = BabblingLine(lines)
    box = driver_on(line, OPTICS)
    try:
        box.open()
    except DeviceError:
        assert line.time_s < 10.0
    else:
        raise AssertionError("babble was taken for a light box")


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 255), st.sampled_from(["OK", "ER"]), NOISE), max_size=60))
def test_open_box_on_babble_never_reports_what_was_not_sent(answers):
    """An open driver that gets undamaged nonsense raises a DeviceError or has read its own level back."""
    line = BabblingLine([])
    box = driver_on(line, OPTICS)
    twin = SimulatedLightBox()
    prepare(box, line, twin)
    line.lines.extend(sealed(f"={number:02X} {word} ".encode() + noise) for number, word, noise in answers)
    try:
        state = box.set_level("spot", DriveLevel(1234))
    except DeviceError:
        return
    assert state.drive == DriveLevel(1234)


def prepare(box: SerialLightBox, line: BabblingLine, twin: SimulatedLightBox) -> None:
    """Open the driver on a twin's answers."""

    def write(request: bytes) -> float:
        twin.receive(request, line.time_s)
        line.lines.extend(emitted.line.rstrip(b"\n") for emitted in twin.emitted)
        twin.emitted.clear()
        return line.time_s

    line.write = write
    box.open()
    line.write = lambda request: line.time_s


@settings(deadline=None)
@given(st.lists(st.one_of(NOISE, NOISE.map(sealed).map(lambda line: line + b"\n")), max_size=20))
def test_box_takes_any_bytes_and_stays_dark(chunks):
    """The simulated box answers any bytes without failing, and lights nothing without a session."""
    twin = SimulatedLightBox()
    for step, chunk in enumerate(chunks):
        twin.receive(chunk.replace(b"HI", b"XX"), step * 0.001)
    assert all(twin.duty(channel.limits.name) == 0 for channel in twin.channels)


def test_request_line_is_the_documented_one():
    """The driver's bytes are those of the protocol's document."""
    assert request_line(7, "SL 1 H 30000") == b"#07 SL 1 H 30000*C04ED159\n"
