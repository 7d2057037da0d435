"""What the simulated light box says and shines over half a minute, how its clock is read, how a box is surveyed."""

from __future__ import annotations

from typing import Any
from zlib import crc32

import numpy as np
import pytest

from drivers.light_box.answers import read_capabilities, read_flash, read_identity, read_state, read_status
from drivers.light_box.clock import BoxClock, ClockSample
from radiometer.acquire.light_levels import LevelSurvey, SpectralCorrection
from radiometer.devices.light_box import ChannelCapabilities, ChannelMode, ChannelState, CurrentRange, DriveLevel
from radiometer.errors import DeviceError, UnsafeStimulus
from simulators.light_box.box import LightBoxTwin
from tests.unit.acquire.test_light_levels import reading
from tests.unit.held.figures import moved

# Second, and what is sent then: commands of every kind, twice the same, damaged, too long, after a pause, while the
# button is held.
TALK = """
0.5 CH 1
0.6 SL 1 H 100
0.7 HI 2
0.8 CH 0
0.9 CH 5
1.0 SL 0 H 30000
1.2 RB 0
1.4 RA 1 H 20000 800
1.8 RB 1
2.3 RB 1
2.4 PU 4 H 1000 50
2.5 SL 2 L 65535
2.6 SL 4 H 4000
2.7 OF 2
2.8 SL 4 L 33000
2.9 BL 3 H 15000 20 30 5
3.1 RB 3
3.3 RB 3
3.4 ST
3.5 TM
3.6 EV 01
3.7 EV 02
3.8 EV 7F
4.6 ST
6.9 ST
7.0 HI 1
7.1 CH 4
7.2 FS
7.3 HI 2
7.4 FS
7.5 FL
7.6 FS
7.7 FL
8.2 SL 5 H 60000
8.3 SL 0 H 1
8.4 BL 1 H 60000 100 100 0
8.9 RB 1
9.3 RB 5
9.9 OF *
10.0 RB 5
10.1 ST
10.2 XX
10.3 SL 9 H 1
10.4 SL 1 H 70000
10.5 PU 1 H 1 600001
30.0 ST
"""


def framed(number: int, text: str) -> bytes:
    body = f"#{number:02X} {text}".encode()
    return body + f"*{crc32(body):08X}\n".encode()


def test_the_simulated_box_talks_and_shines_as_it_did():
    """Every line that it sends with its time, and what its channels emit each tenth of a second."""
    twin = LightBoxTwin()
    lines = [line.split(" ", 1) for line in TALK.split("\n")[1:-1]]
    for time_s, pressed in ((3.05, True), (3.45, False), (9.0, True), (9.4, False), (12.0, True), (29.0, False)):
        twin.press(time_s, pressed=pressed)
    emission: dict[str, list[Any]] = {"bleach": [], "spot": [], "spot_red": [], "fixation": []}
    duties = []
    tick = 0
    for number, (when, text) in enumerate(lines):
        while tick / 10 < float(when):
            for channel, seen in emission.items():
                seen.append(twin.emission(channel, tick / 10).radiance_w_sr_m2)
            duties.append([twin.duty(channel) for channel in emission])
            tick += 1
        twin.receive(framed(number, text), float(when))
        if number % 9 == 4:  # once more, and once damaged
            twin.receive(framed(number, text), float(when) + 0.004)
            twin.receive(b"#00 ST*00000000\n" + b"x" * 80 + b"\n", float(when) + 0.008)
    told = {
        "lines": [[round(one.time_s, 6), one.line.decode("latin-1").strip()] for one in twin.emitted],
        "emission": emission,
        "duties": np.array(duties),
        "state": [twin.bad_lines, twin.darkened, twin.latest_event, twin.session, twin.held, twin.box_ms],
        "flash": [twin.flash.left, twin.flash.wait_ms(twin.whole_ms)] if hasattr(twin.flash, "wait_ms") else None,
    }
    assert not moved("boxes/twin", told, rel=1e-8)


@pytest.mark.parametrize("rate", [0.0, 3e-4])
def test_a_clock_is_read_as_it_was(rate):
    """Offset, drift and their u after exchanges of uneven delays, and a time of the box in the host's."""
    rng = np.random.default_rng(8)
    clock = BoxClock()
    told: dict[str, Any] = {"at": []}
    for step in range(300):
        out_s, back_s = rng.exponential([4e-4, 9e-4]) + (0.02 if step % 17 == 3 else 0.0)
        host_s = 0.3 * step
        box_s = (host_s + out_s - 3.0) * (1 + rate)
        clock.add(ClockSample(host_s, box_s, box_s + 0.001, host_s + out_s + 0.001 + back_s, 0.0012, 0.003))
        if step in (3, 40, 299):
            found = clock.estimate()
            told["at"].append({name: getattr(found, name) for name in found.__dataclass_fields__})
            told["at"][-1]["host"] = list(clock.host_time_s(0.25 * step))
    assert not moved(f"boxes/clock_{rate:g}", told, rel=1e-6)


class TiringBox:
    """A box whose light sinks as it warms, uses up its energy, and may not be as bright as it could for long."""

    def __init__(self) -> None:
        limits = {CurrentRange.LOW: 65535, CurrentRange.HIGH: 30000}
        self.channels = {"spot": ChannelCapabilities("spot", 460.0, 4096, 1000.0, limits)}
        self.drive, self.lit_s, self.energy, self.mode = DriveLevel(0), 0.0, 1.0, ChannelMode.OFF
        self.done: list[str] = []

    def share(self) -> float:
        return self.drive.level / 30_000 if self.drive.current_range is CurrentRange.HIGH else self.drive.level / 7.5e6

    def safe(self) -> None:
        self.off("spot")

    def off(self, channel: str) -> None:
        self.drive, self.lit_s, self.mode = DriveLevel(0), 0.0, ChannelMode.OFF
        self.done.append("off")

    def set_level(self, channel: str, level: DriveLevel) -> None:
        self._light(level, 0.5, ChannelMode.STEADY, "steady")

    def pulse(self, channel: str, level: DriveLevel, seconds: float) -> None:
        self._light(level, 150.0 / seconds, ChannelMode.PULSE, f"{seconds:g} s")

    def _light(self, level: DriveLevel, most: float, mode: ChannelMode, name: str) -> None:
        before, self.drive = self.drive, level
        if self.share() > most:
            self.drive = before
            raise UnsafeStimulus("too bright")
        self.lit_s, self.mode = 0.0, mode
        self.done.append(f"{level.level} {level.current_range} {name}")

    def read_channel(self, channel: str) -> ChannelState:
        return ChannelState(channel, self.mode, self.drive, 4096, self.energy)

    def wait(self, seconds: float) -> None:
        self.lit_s += seconds
        self.energy = min(max(self.energy + seconds * (0.01 - 0.02 * self.share()), 0.05), 1.0)
        self.done.append(f"wait {seconds:g}")

    def measure(self) -> Any:
        warmth = 1.0 - 0.03 * (1.0 - np.exp(-self.lit_s / 30.0))
        return reading(0.02 + 30.0 * self.share() * warmth, noise=1e-4, shared=0.01, black=1e-5)


def test_a_survey_of_levels_is_as_it_was():
    """Which levels are lit for how long in what order, the waits between, and the calibration that comes of them."""
    box = TiringBox()
    survey = LevelSurvey(box, box.measure, box.wait, np.random.default_rng(1), points_per_decade=2.0)
    steps: list[str] = []
    survey.progress = lambda channel, done, of: steps.append(f"{channel} {done} of {of}")
    made = survey.survey("spot", SpectralCorrection(1.05, 0.02))
    told = {"made": made.model_dump(mode="json"), "done": box.done, "progress": steps}
    assert not moved("boxes/survey", told, rel=1e-7)


# What a box may answer to HI, CH, RB, ST and FS: right, and each field missing, strange or of another kind.
ANSWERS = {
    "HI": ("radiometer-light-box", "2", "1.4", "LB-7", "6"),
    "CH": ("spot", "460", "4096", "977", "65535", "30000", "2000", "1"),
    "RB": ("S", "H", "30000", "4096", "1500"),
    "ST": ("11987", "-52", "3", "4", "5", "W", "1", "0"),
    "FS": ("2", "5400"),
}
READERS = {
    "HI": lambda fields: read_identity("ttyX", fields),
    "CH": lambda fields: read_capabilities("ttyX", fields),
    "RB": lambda fields: read_state("ttyX", "spot", 2000, fields),
    "ST": lambda fields: read_status("ttyX", fields),
    "FS": lambda fields: read_flash("ttyX", fields),
}


@pytest.mark.parametrize("verb", ANSWERS)
def test_answers_of_a_box_are_read_as_they_were(verb):
    """Every field in its unit; a field too few, too many, or without sense is told with the way out."""
    good, told = ANSWERS[verb], {}
    tried = {"good": good, "one less": good[:-1], "one more": (*good, "0"), "nothing": ()}
    tried |= {
        f"field {k} is {word!r}": (*good[:k], word, *good[k + 1 :])
        for k in range(len(good))
        for word in ("x", "-1", "0")
    }
    for name, fields in tried.items():
        try:
            told[name] = str(READERS[verb](fields))
        except DeviceError as error:
            told[name] = f"{type(error).__name__}: {error}"
    assert not moved(f"boxes/answers_{verb}", told)
