"""The simulated light box beyond its protocol, which the firmware's tests hold it to, and the physics of its LEDs."""

import re
from itertools import pairwise
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from drivers.light_box.link import request_line
from simulators.light_box.box import Commands, SimulatedLightBox
from simulators.light_box.channel import REFERENCE_CHANNELS, REFERENCE_LEDS, ChannelLimits, LedState, effective_duty
from simulators.light_box.lines import LAG_S, PtyServer, WiredLightBox

FIRMWARE = Path(__file__).resolve().parents[4] / "drivers" / "firmware" / "light_box"


def greeted() -> tuple[SimulatedLightBox, Commands]:
    twin = SimulatedLightBox()
    commands = Commands(twin)
    assert commands.run("HI 2").startswith("OK radiometer-light-box 2")
    return twin, commands


def test_events_are_numbered_from_0_to_255_and_on_from_0() -> None:
    """The one after FF is 00, as two hexadecimal digits hold it."""
    twin, commands = greeted()
    while twin.latest_event != 255:
        twin.add_event("BT", "1", 100.0)
    twin.add_event("BT", "0", 200.0)
    assert twin.latest_event == 0
    assert commands.run("EV 00").startswith("OK")
    assert commands.run("EV FF").startswith("OK")


def test_a_box_counts_how_often_it_went_dark_by_itself() -> None:
    """Once for a channel's energy (47e6 units at 235 a ms: 200 s), once for the held button, once for a silent host."""
    twin, commands = greeted()

    def speak(number: int, text: str, time_s: float) -> str:
        body = f"#{number % 256:02X} {text}".encode()
        twin.receive(body + f"*{crc32(body):08X}\n".encode(), time_s)
        return twin.emitted[-1].line[4:-10].decode()

    def darkened(number: int, time_s: float) -> str:
        return speak(number, "ST", time_s).split()[5]

    assert speak(0, "HI 2", 0.01).startswith("OK")
    assert speak(1, "SL 0 H 59904", 0.02).startswith("OK")
    counts = [darkened(2 + step, 0.5 * (1 + step)) for step in range(402)]
    assert counts == ["0"] * 400 + ["1"] * 2
    assert speak(1, "SL 5 H 100", 201.1).startswith("OK")
    twin.press(201.2)
    assert darkened(2, 201.3) == "1"
    counts = [darkened(3 + step, 201.5 + 0.5 * step) for step in range(14)]
    assert counts == sorted(counts)
    assert counts[-1] == "2"
    twin.advance(220.0)
    assert commands.run("ST").split()[5:] == ["3", "P", "1", "0"]


@pytest.mark.parametrize(
    ("words", "lit"),
    [("PU 1 H 20000 7", "1" * 7), ("BL 1 H 20000 5 3 4", "11111000" * 3 + "11111"),
     ("BL 4 L 65535 2 6 2", "11000000" * 2), ("BL 1 H 20000 1 1 3", "101010")],
)  # fmt: skip
def test_light_is_as_long_as_was_asked_however_time_passes(words: str, lit: str) -> None:
    """Millisecond by millisecond, or as many at once as there are: the same are lit, and none after the last."""
    for steps in (1, 2, 40):
        twin, commands = greeted()
        assert commands.run(words).startswith("OK")
        name, seen = twin.settings.channels[int(words.split()[1])].name, []
        for ms in range(0, 40, steps):
            seen.append("1" if twin.duty(name) else "0")
            twin.advance((ms + steps) / 1000.0)
        assert "".join(seen) == lit.ljust(40, "0")[::steps]
        assert twin.duty(name) == 0.0


def test_the_twin_has_the_limits_that_stand_in_the_firmware() -> None:
    """Name, peak, steps, levels, bucket and refill of each channel, in their order, are those of limits.c."""
    text = (FIRMWARE / "limits.c").read_text()
    steps = dict(re.findall(r"#define (\w+_STEPS) (\d+)", (FIRMWARE / "config.h").read_text()))
    row = re.compile(r'\{"(\w+)", (\d+), (\w+), \{(\d+), (\d+)\}, UNITS\((\d+)UL\), (\d+)\}')
    found = [
        ChannelLimits(name, int(peak), int(steps[duty]), *map(int, others))
        for name, peak, duty, *others in row.findall(text)
    ]
    assert tuple(found) == REFERENCE_CHANNELS


def test_the_twin_reports_when_something_happens_by_itself_next() -> None:
    """Without a host nothing; a second after its last word; a light that ends or a press planned sooner comes first."""
    assert SimulatedLightBox().next_time_s() is None
    twin, commands = greeted()
    reported_s = twin.time_s
    assert twin.next_time_s() == pytest.approx(reported_s + 1.0, abs=2e-3)
    twin.advance(reported_s + 0.4)
    assert twin.next_time_s() == pytest.approx(reported_s + 1.0, abs=2e-3)
    assert commands.run("PU 1 H 20000 250").startswith("OK")
    assert twin.next_time_s() == pytest.approx(reported_s + 0.65, abs=2e-3)
    twin.press(reported_s + 0.5)
    assert twin.next_time_s() == pytest.approx(reported_s + 0.5, abs=2e-3)
    twin.advance(reported_s + 3.0)
    assert not twin.session
    assert twin.next_time_s() == pytest.approx(
        reported_s + 0.5 + 3.0, abs=2e-3
    )  # held for three seconds: all lights stay off
    twin.advance(reported_s + 3.6)
    assert twin.next_time_s() is None


@pytest.mark.parametrize("words", ["OF *", "OF 1", "HI 2"])
def test_what_is_switched_off_is_dark_in_the_light_at_once(words: str) -> None:
    """By one name, by all, or by a new greeting: the LED's own light and its pin, not the channel's state alone."""
    twin, commands = greeted()
    assert commands.run("SL 1 H 20000").startswith("OK")
    assert twin.emission("spot", 0.5).radiance_w_sr_m2 > 0.0
    reported = []
    twin.watch = lambda: reported.append(twin.duty("spot"))
    assert commands.run(words).startswith("OK")
    assert twin.emission("spot", twin.time_s + 0.1).radiance_w_sr_m2 == 0.0
    assert reported == [0.0]


@pytest.mark.parametrize("steps", [(0.7, 0.1), (0.1, 0.1, 0.1), (0.25, 0.25), (0.0003, 0.0007)])
def test_whole_milliseconds_are_counted_whole(steps: tuple[float, ...]) -> None:
    """Times that add up to a pulse's end in decimal end it, although their binary sums may lie a little below."""
    twin, commands = greeted()
    begun_s = twin.time_s
    assert begun_s == 0.0
    whole_ms = round(1000 * sum(steps))
    assert commands.run(f"PU 1 H 20000 {whole_ms}").startswith("OK")
    passed_s = 0.0
    for step in steps:
        assert twin.emission("spot", passed_s).radiance_w_sr_m2 > 0.0
        passed_s += step
    assert twin.emission("spot", passed_s).radiance_w_sr_m2 == 0.0


BLUE = REFERENCE_LEDS["spot"]


def test_emission_is_that_of_waveform_current_and_heating():
    """Low current is dimmer and more efficient; full duty droops and reddens."""
    led = LedState(BLUE)
    duty = 1001 / 8192
    led.drive(duty, high=True, time_s=0.0)
    cycle_s = BLUE.pwm_period_s * BLUE.dither_periods
    times_s = (np.arange(800_000) + 0.5) * cycle_s / 800_000
    assert led.waveform(times_s).mean() == pytest.approx(led.emission(0.0).radiance_w_sr_m2, rel=2e-5)
    low, high = LedState(BLUE), LedState(BLUE)
    low.drive(0.5, high=False, time_s=0.0)
    high.drive(0.5, high=True, time_s=0.0)
    ratio = low.emission(0.0).radiance_w_sr_m2 / high.emission(0.0).radiance_w_sr_m2
    assert ratio == pytest.approx(BLUE.low_current_ratio * BLUE.low_efficacy_gain, rel=1e-9)
    assert effective_duty(BLUE, 8 / 8192) / (8 / 8192) < 0.75
    assert effective_duty(BLUE, 0.5) / 0.5 == pytest.approx(1.0, abs=1e-3)
    assert LedState(BLUE).emission(5.0).radiance_w_sr_m2 == 0.0
    led = LedState(BLUE)
    led.drive(1.0, high=True, time_s=0.0)
    droop = BLUE.efficiency_per_kelvin * BLUE.heating_kelvin
    cold, half, settled = (led.emission(BLUE.heating_tau_s * n) for n in (0.0, np.log(2), 20.0))
    assert settled.radiance_w_sr_m2 / cold.radiance_w_sr_m2 == pytest.approx(1 + droop, rel=1e-6)
    assert 1 - half.radiance_w_sr_m2 / cold.radiance_w_sr_m2 == pytest.approx(-droop / 2, rel=1e-6)
    shift_nm = BLUE.peak_shift_nm_per_kelvin * BLUE.heating_kelvin
    assert led.emission(1e4).peak_nm == pytest.approx(BLUE.peak_nm + shift_nm, abs=1e-6)


class _Clock:
    """Real time as the test sets it."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def _greeted() -> tuple[_Clock, PtyServer, SimulatedLightBox]:
    """Return a served box with a session that was begun at 0.2 s, its clock and the server."""
    clock, twin = _Clock(), SimulatedLightBox()
    server = PtyServer(WiredLightBox(twin), clock=clock)
    for clock.now_s, sent in ((0.1, request_line(1, "HI 2")), (0.2, b"")):
        server.device.exchange(sent, server.time_s())
    assert twin.session
    return clock, server, twin


def _pass(clock: _Clock, server: PtyServer, until_s: float, step_s: float) -> None:
    while clock.now_s < until_s - 1e-9:
        clock.now_s += step_s
        server.device.exchange(b"", server.time_s())


def test_a_box_kept_from_running_loses_time_and_no_session() -> None:
    """Five seconds end none; what is given up never comes back."""
    clock, server, twin = _greeted()
    clock.now_s = 5.2
    server.device.exchange(b"", server.time_s())
    assert twin.session
    _pass(clock, server, 6.2, 0.1)
    assert not twin.session
    clock, server, _ = _greeted()
    times_s = []
    for clock.now_s in (0.3, 0.7, 3.0, 3.1, 3.4, 9.0, 9.001):
        times_s.append(server.time_s())
    steps_s = [later - earlier for earlier, later in pairwise([0.2, *times_s])]
    assert steps_s == pytest.approx([0.1, 0.4, LAG_S, 0.1, 0.3, LAG_S, 0.001])


@pytest.mark.parametrize("step_s", [0.002, 0.3])
def test_a_box_that_runs_goes_dark_for_a_silent_host(step_s: float) -> None:
    """Short steps of time are all true time: after 1 s of silence the session is over, before it is not."""
    clock, server, twin = _greeted()
    _pass(clock, server, 0.8, step_s)
    assert twin.session
    _pass(clock, server, 1.6, step_s)
    assert not twin.session
