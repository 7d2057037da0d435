"""The firmware's code and the simulated box, which share none: byte for byte the same, whatever is asked of them."""

from dataclasses import replace
from zlib import crc32

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.channel import REFERENCE_CHANNELS
from testing.firmware_board import SERIAL
from tests.unit.firmware.conftest import DIVISOR

SMALL = tuple(replace(limits, bucket=limits.bucket // DIVISOR) for limits in REFERENCE_CHANNELS)
OUTPUT_OF = {"bleach": 0, "field": 0, "spot": 1, "spot_red": 2, "spot_green": 2, "fixation": 3}

numbers = st.sampled_from([0, 1, 2, 5, 60, 255, 256, 1000, 4999, 20_000, 20_001, 60_000, 60_001, 65_535, 65_536])
channels = st.integers(0, 6)
ranges = st.sampled_from(["L", "H", "H", "X"])
levels = st.sampled_from([0, 1, 255, 256, 5000, 20_000, 20_001, 32_768, 60_000, 60_001, 65_535, 65_536])
times = st.sampled_from([0, 1, 2, 3, 7, 20, 100, 60_000, 60_001, 600_000, 600_001, 4_294_967_296])
counts = st.sampled_from([0, 1, 2, 3, 65_535, 65_536])


def words(verb, *arguments):
    return st.builds(lambda *given: " ".join([verb, *map(str, given)]), *arguments)


requests = st.one_of(
    words("HI", st.sampled_from([1, 2, 2, 2, 3])),
    words("CH", channels),
    words("SL", channels, ranges, levels),
    words("RA", channels, ranges, levels, times),
    words("PU", channels, ranges, levels, times),
    words("BL", channels, ranges, levels, times, times, counts),
    words("OF", st.one_of(channels, st.just("*"))),
    words("RB", channels),
    words("EV", st.sampled_from(["01", "02", "10", "11", "0g", "1", "FF"])),
    st.sampled_from(
        ["TM", "FL", "FS", "FL 1", "FS 1", "TM 1", "XX", "", "SL 1", "SL 1 H 5 5", "BL 1 H 5 5 5 5 5 5", "HI"]
    ),
)
short = st.integers(1, 9)
lit = st.one_of(
    words("SL", st.integers(0, 5), st.sampled_from("LH"), st.sampled_from([1, 300, 5000, 20_000, 60_000])),
    words("RA", st.integers(0, 5), st.sampled_from("LH"), st.sampled_from([0, 7, 5000, 20_000]), st.integers(1, 40)),
    words("PU", st.integers(0, 5), st.sampled_from("LH"), st.sampled_from([1, 5000, 20_000]), st.integers(1, 40)),
    words(
        "BL", st.integers(0, 5), st.just("H"), st.sampled_from([1, 9000]), st.integers(1, 9), st.integers(1, 9), counts
    ),
)
waits = st.sampled_from([0, 0, 1, 2, 3, 5, 9, 21, 60, 400, 999, 1000, 1500, 5000])
raw = st.sampled_from(
    [b"#01 TM*00000000\n", b"\n", b"\r\n", b"junk", b"#0x TM*12345678\n", b"x" * 70 + b"\n", b"#01 TM\n", b"#", b"*\n"]
)
presses = st.sampled_from(["press", "release", "reset"])
steps = st.lists(st.one_of(requests, lit, lit, waits, raw, presses), min_size=4, max_size=30)


class Pair:
    """A firmware box and a twin that get the same commands at the same time."""

    def __init__(self, power, kind):
        self.power, self.kind, self.box = power, kind, power(kind)
        self.ms, self.sequence, self.pressed_ms = 0, 0, None
        channels = SMALL if kind == "small" else REFERENCE_CHANNELS
        self.twin = SimulatedLightBox(SimulatedBoxSettings(serial=SERIAL, channels=channels))
        self.pass_ms(1)

    def reset(self):
        """Pull the reset line of both, their contacts open: what the memories hold is all that stays."""
        self.turn(False)
        self.agree()
        self.box = self.power(self.kind, reset_flags=2, memory=self.box.memory)
        self.twin.reset("E")
        self.pass_ms(1)

    def pass_ms(self, ms):
        self.ms += ms
        self.box.run(ms)
        self.twin.advance(self.ms / 1000.0)

    def send(self, line):
        self.box.send(line)
        self.twin.receive(line, self.ms / 1000.0)

    def ask(self, words):
        self.sequence = (self.sequence + 1) % 256
        body = f"#{self.sequence:02X} {words}"
        self.send(f"{body}*{crc32(body.encode()):08X}\n".encode())

    def turn(self, pressed):
        """Turn the contact and let its bounce time pass; a contact that is there already stays."""
        if pressed == self.twin.button:
            return
        self.box.contact(closed=pressed)
        self.twin.press(self.ms / 1000.0, pressed=pressed)
        self.twin.advance(self.ms / 1000.0)
        self.pass_ms(20)

    def agree(self):
        """Hold what both have sent, what their outputs do and what they say of themselves against each other."""
        assert self.box.take() == b"".join(line.line for line in self.twin.emitted)
        self.twin.emitted.clear()
        duties = [0.0] * 4
        for channel in self.twin.channels:
            duties[OUTPUT_OF[channel.limits.name]] += self.twin.duty(channel.limits.name)
        assert self.box.duties() == pytest.approx(duties, abs=1e-9)


@pytest.mark.parametrize("kind", ["whole", "small"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=steps)
@example(steps=["SL 0 H 20000", "press"])  # dark in the midst of a wait, its budget spent to the rest
def test_firmware_and_twin_say_and_do_the_same(power, kind, steps):
    """Any mixture of requests, damaged lines, waiting and pressing: every byte, every duty, every bucket agree."""
    pair = Pair(power, kind)
    pair.agree()
    pair.ask("HI 2")
    for step in steps:
        if isinstance(step, int):
            pair.pass_ms(step)
        elif isinstance(step, bytes):
            pair.send(step)
        elif step == "reset":
            pair.reset()
        elif step in ("press", "release"):
            pair.turn(step == "press")
        else:
            pair.ask(step)
        pair.agree()
    pair.send(b"\n")
    for n in range(6):
        pair.ask(f"RB {n}")
    pair.ask("TM")
    pair.agree()
