"""Parser, driver and box on arbitrary bytes: no crash, no hang."""

from __future__ import annotations

from collections import deque
from zlib import crc32

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.light_box.box import SerialLightBox
from drivers.light_box.frames import Event, Reply, parse_event_fields, parse_line, parse_times, request_line
from drivers.light_box.link import BoxLink
from drivers.light_box.serial_line import ReceivedLine
from radiometer.devices import DriveLevel
from radiometer.devices.exposure_account import MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import DeviceError
from simulators.light_box.box import SimulatedLightBox

OPTICS = {name: ChannelOptics(640.0, 18.0, 1.5, 1.0) for name in ("bleach", "spot", "spot_red", "fixation")}
FRAGMENTS = st.sampled_from([b"=", b"!", b"*", b"#", b" OK", b" ER 05", b"--", b"TM", b"1.000", b"\n", b"00", b"HI 1"])
NOISE = st.lists(st.one_of(st.binary(max_size=20), FRAGMENTS), max_size=12).map(b"".join)


def sealed(body: bytes) -> bytes:
    """Return a line whose checksum is right, whatever it says."""
    return body + f"*{crc32(body):08X}".encode()


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


@pytest.mark.slow
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
    box = SerialLightBox(BoxLink(line), ExposureLedger(OPTICS, MemoryStore(line.now, ("TWIN0001",))), keep_alive=False)
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
    box = SerialLightBox(BoxLink(line), ExposureLedger(OPTICS, MemoryStore(line.now, ("TWIN0001",))), keep_alive=False)
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
