"""What only the firmware has: pins, interrupts, timing."""

from zlib import crc32

import pytest

from radiometer.errors import MissingLibrary
from simulators.light_box.avr_box import AvrBox

PINS = ("bleach", "spot", "spot_red", "fixation")


@pytest.fixture
def avr(light_box_hex):
    """Return the firmware, powered for 20 ms: it reads its EEPROM first."""
    try:
        box = AvrBox(light_box_hex)
    except MissingLibrary as missing:
        pytest.skip(str(missing))
    box.run(0.02)
    box.take_sent()
    return box


@pytest.fixture
def ask(avr):
    """Return a function that sends a request and returns the answer."""

    def asked(body, wait_s=0.012):
        avr.send(f"{body}*{crc32(body.encode()):08X}\n".encode())
        avr.run(wait_s)
        return avr.take_sent()

    return asked


def test_refused_level_makes_not_one_edge(avr, ask):
    """No pin has risen from power-on, nor by a level above the limit, not even for a PWM period."""
    ask("#00 HI 1")
    for number, words in enumerate(("SL 3 H 20001", "PU 3 H 65535 100", "BL 3 H 30000 5 5 9", "RA 3 H 20001 50")):
        assert b"ER 05" in ask(f"#{number + 1:02X} {words}")
    avr.run(0.2)
    assert not any(level for _, level in avr.pins["fixation"].edges)
    assert not avr.is_high_current("fixation")
    assert all(not any(level for _, level in avr.pins[name].edges) for name in PINS)
    assert not any(avr.is_high_current(name) for name in PINS)


@pytest.mark.parametrize("level", [8, 12345, 60000])
def test_duty_at_the_spot_is_the_stated_step(avr, ask, level):
    """Over 32 dithering cycles the pin is high for the stated steps of 8192, within simavr's 2 cycles per edge."""
    ask("#00 HI 1")
    ask(f"#01 SL 1 H {level}", 0.05)
    steps = ((level + (level >> 15)) * 8192 + 32768) >> 16
    assert avr.duty("spot", 256 * 64e-6) == pytest.approx(steps / 8192, abs=2 / 1024 + 1 / 256)


def test_pulse_has_its_length(avr, ask):
    """A pulse of 50 ms ends within 0.2 ms of its length."""
    ask("#00 HI 1")
    ask("#01 PU 1 H 60000 50", 0.08)
    edges = avr.pins["spot"].edges
    first = next(cycle for cycle, level in edges if level)
    assert (edges[-1][0] - first) / 16e6 == pytest.approx(0.050, abs=0.0012)  # it starts within a millisecond


def test_range_switch_never_shows_the_old_duty_at_the_new_current(avr, ask):
    """When the current is switched the pin is low."""
    ask("#00 HI 1")
    ask("#01 SL 1 L 60000")
    ask("#02 SL 1 H 100")
    switched = next(cycle for cycle, level in avr.range_pins["spot"].edges if level)
    before = [level for cycle, level in avr.pins["spot"].edges if cycle <= switched]
    assert before[-1] is False
    after = avr.pins["spot"].high_fraction(switched, switched + 64_000)
    assert after < 0.01


def test_button_is_stamped_within_twenty_microseconds(avr):
    """The event's time is the edge's, on the box's clock, whatever the main loop does."""
    stamps_s, pressed_s = [], []
    for press in range(6):
        avr.run(0.0203)
        pressed_s.append(avr.avr.time_s)
        avr.press(pressed=press % 2 == 0)
        avr.run(0.02)
        stamps_s.append(float(avr.take_sent().split()[3].split(b"*")[0]) / 1000)
    delays_s = [stamp - pressed for stamp, pressed in zip(stamps_s, pressed_s, strict=True)]
    assert max(delays_s) - min(delays_s) < 2e-5  # what they have in common is the moment at which the clock started
    assert abs(max(delays_s)) < 1e-3


def test_line_is_served_while_all_channels_ramp_and_blink(avr, ask):
    """At full load no byte is lost and every request is answered."""
    ask("#00 HI 1")
    for channel in range(3):
        ask(f"#{channel + 1:02X} RA {channel} L 60000 3000")
    ask("#04 BL 3 L 20000 1 1 0")
    answered = sum(b" OK " in ask(f"#{number:02X} TM") for number in range(16, 116))
    assert answered == 100
    status = ask("#F0 ST").split()
    assert status[4:6] == [b"0", b"0"]


def test_shared_output_drives_one_of_its_two_leds(avr, ask):
    """Bleach and field share a pin: the select line says whose light it is, and changes in darkness only."""
    ask("#00 HI 2")
    ask("#01 SL 0 L 30000")
    assert (avr.duty("bleach") > 0.3, avr.duty("field"), avr.select_pins["field"].level) == (True, 0.0, False)
    ask("#02 OF 0")
    ask("#03 SL 5 H 30000")
    assert (avr.duty("bleach"), avr.duty("field") > 0.3, avr.is_high_current("field")) == (0.0, True, True)
    assert not avr.is_high_current("bleach")
    for cycle, _ in avr.select_pins["field"].edges:
        before = [level for when, level in avr.pins["bleach"].edges if when <= cycle]
        assert not before or before[-1] is False
    ask("#04 OF 0")  # its partner's light is not this channel's to end
    assert avr.duty("field") > 0.3
    ask("#05 OF 5")
    assert (avr.duty("field"), avr.is_high_current("field")) == (0.0, False)


def test_trigger_of_the_flash_is_one_pulse_of_ten_milliseconds(avr, ask):
    """The trigger rises once for 10 ms; a refused flash makes no edge."""
    assert not any(level for _, level in avr.trigger.edges)
    ask("#00 HI 2")
    ask("#01 FL", 0.05)
    assert b"ER 06" in ask("#02 FL", 0.05)
    (rise, _), (fall, _) = [edge for edge in avr.trigger.edges if edge[0] > 1000][-2:]
    assert (fall - rise) / 16e6 == pytest.approx(0.010, abs=0.0011)
    assert sum(level for _, level in avr.trigger.edges) == 1


def test_opening_the_port_gives_no_energy_back(small_bucket_hex):
    """Half of the field's 0.75 s given, then a reset: the bucket holds no more, the flash is remembered."""
    avr = AvrBox(small_bucket_hex)
    avr.run(0.05)

    def ask(body, wait_s=0.06):
        avr.send(f"{body}*{crc32(body.encode()):08X}\n".encode())
        avr.run(wait_s)
        return avr.take_sent()

    def bucket():
        ask("#00 HI 2")
        return int(ask("#01 RB 5").split()[6].split(b"*")[0])

    full = bucket()
    assert b"OK 1 5000" in ask("#02 FL")
    ask("#03 PU 5 H 60000 400", 0.45)
    before = bucket()
    assert before < 0.6 * full
    avr.reset()
    avr.run(0.05)
    avr.take_sent()
    after = bucket()
    dark_units = 0.3 * 1000 * 118  # refilled since `before` was read
    assert 0 < after <= before + dark_units
    assert b"OK 1 " in ask("#04 FS")
